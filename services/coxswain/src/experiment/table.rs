//! Rows → the table that is printed: one figure by scenario, contender and start, and what it comes to. A losing cell looks like a
//! winning one.
//!
//! ```text
//! geometric mean, of b      exp(mean over scenarios of ln(x / b)),  x and b means over the seeds
//! gap closed                Σ(observer − x) / Σ(observer − oracle)  over the scenarios
//! worst                     largest (x − 2 mm) / min(mpc, observer) over scenarios × seeds
//! ```

use super::contender::Contender;
use super::figure::Figure;
use super::trial::{Row, Start};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;

/// By how much a controller may be worse than the better baseline before it counts \[m\].
const GRACE_M: f64 = 0.002;

/// Who, and with what known at the start.
type Column = (Contender, Start);

/// One figure of all rows.
struct Cells<'a> {
    values: BTreeMap<(&'a str, Column), BTreeMap<u64, f64>>,
    scenarios: BTreeSet<&'a str>,
    columns: BTreeSet<Column>,
}

impl<'a> Cells<'a> {
    fn new(rows: &'a [Row], figure: Figure) -> Self {
        let mut cells =
            Self { values: BTreeMap::new(), scenarios: BTreeSet::new(), columns: BTreeSet::new() };
        for row in rows {
            let column = (row.controller, row.start);
            // A figure that a row cannot have is not told.
            let value = Some(figure.of(row)).filter(|value| !value.is_nan());
            cells
                .values
                .entry((&row.scenario, column))
                .or_default()
                .extend(value.map(|value| (row.seed, value)));
            cells.scenarios.insert(&row.scenario);
            cells.columns.insert(column);
        }
        cells
    }

    fn mean(&self, scenario: &str, column: Column) -> Option<f64> {
        let seeds = self.values.get(&(scenario, column)).filter(|seeds| !seeds.is_empty())?;
        Some(seeds.values().sum::<f64>() / seeds.len() as f64)
    }

    /// The column of a contender that learns nothing, and so starts in one way only.
    fn baseline(&self, contender: Contender) -> Option<Column> {
        self.columns.iter().copied().find(|column| column.0 == contender)
    }

    fn geometric_mean(&self, column: Column, baseline: Column) -> Option<f64> {
        let ratios = self.scenarios.iter().filter_map(|scenario| {
            Some((self.mean(scenario, column)? / self.mean(scenario, baseline)?).ln())
        });
        let (count, sum) = ratios.fold((0, 0.0), |(count, sum), ratio| (count + 1, sum + ratio));
        (count > 0).then(|| (sum / f64::from(count)).exp())
    }

    fn gap_closed(&self, column: Column) -> Option<f64> {
        let (observer, oracle) =
            (self.baseline(Contender::MpcObserver)?, self.baseline(Contender::OracleMpc)?);
        let gaps = self.scenarios.iter().filter_map(|scenario| {
            let from = self.mean(scenario, observer)?;
            Some((from - self.mean(scenario, column)?, from - self.mean(scenario, oracle)?))
        });
        let (closed, whole) =
            gaps.fold((0.0, 0.0), |(closed, whole), gap| (closed + gap.0, whole + gap.1));
        (whole != 0.0).then(|| closed / whole)
    }

    /// The largest ratio, and its scenario and seed.
    fn worst(&self, column: Column) -> Option<(f64, &'a str, u64)> {
        let (mpc, observer) =
            (self.baseline(Contender::Mpc)?, self.baseline(Contender::MpcObserver)?);
        let mut worst: Option<(f64, &'a str, u64)> = None;
        for &scenario in &self.scenarios {
            let Some(seeds) = self.values.get(&(scenario, column)) else { continue };
            for (&seed, value) in seeds {
                let of = |baseline| self.values.get(&(scenario, baseline))?.get(&seed).copied();
                let (Some(mpc), Some(observer)) = (of(mpc), of(observer)) else { continue };
                let ratio = (value - GRACE_M) / mpc.min(observer);
                if worst.is_none_or(|(before, ..)| ratio > before) {
                    worst = Some((ratio, scenario, seed));
                }
            }
        }
        worst
    }
}

/// The table of one figure.
pub(super) fn render(rows: &[Row], figure: Figure) -> String {
    let cells = Cells::new(rows, figure);
    let (title, scale) = figure.title_and_scale();
    let mut out = format!("{title}, mean over the seeds");
    let mut line = |name: &str, cell: &dyn Fn(Column) -> Option<String>| {
        // Writing to a String never fails.
        let _ = write!(out, "\n{name:40}");
        for &column in &cells.columns {
            let _ = write!(out, "  {:>16}", cell(column).unwrap_or_else(|| "-".into()));
        }
    };
    line("controller", &|(contender, _)| Some(contender.to_string()));
    line("start", &|(contender, start)| contender.learns().then(|| start.to_string()));
    for scenario in &cells.scenarios {
        line(scenario, &|column| {
            cells.mean(scenario, column).map(|mean| format!("{:.1}", scale * mean))
        });
    }
    for contender in [Contender::Mpc, Contender::MpcObserver, Contender::RlsMpcObserver] {
        let Some(baseline) = cells.baseline(contender) else { continue };
        line(&format!("geometric mean, of {contender}"), &|column| {
            cells.geometric_mean(column, baseline).map(|ratio| format!("{ratio:.3}"))
        });
    }
    if figure != Figure::PositionRmse {
        return out;
    }
    line("gap closed from mpc+observer to oracle", &|column| {
        cells.gap_closed(column).map(|share| format!("{:.0} %", 100.0 * share))
    });
    line("worst, less 2 mm, of the better baseline", &|column| {
        cells.worst(column).map(|(ratio, ..)| format!("{ratio:.2}"))
    });
    for &(contender, start) in &cells.columns {
        if let Some((ratio, scenario, seed)) = cells.worst((contender, start)) {
            let known = if contender.learns() { format!(" {start}") } else { String::new() };
            let _ =
                write!(out, "\nworst of {contender}{known}: {ratio:.2} in {scenario}, seed {seed}");
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(controller: Contender, seed: u64, position_rmse_m: Option<f64>) -> Row {
        Row {
            scenario: "figure-eight+payload".into(),
            profile: "paper".into(),
            controller,
            start: Start::Cold,
            seed,
            poison: None,
            learned_share: [0.0; 3],
            simple_share: 0.0,
            duration_s: 30.0,
            arrival_s: None,
            speed_settle_s: None,
            steady_speed_error_mps: None,
            position_rmse_m,
            position_max_m: None,
            position_at_end_m: None,
            recovery_s: None,
            delay_found_s: None,
            heading_rmse_rad: None,
            input_effort: 0.0,
            constraint_violations: 0,
            corridor_violations: None,
            coverage: None,
            tick_p50_us: None,
            tick_p99_us: None,
        }
    }

    fn line<'a>(table: &'a str, beginning: &str) -> &'a str {
        table.lines().find(|line| line.starts_with(beginning)).unwrap_or_default()
    }

    #[test]
    fn a_losing_cell_is_printed_like_a_winning_one() {
        let rows = [
            row(Contender::MpcObserver, 1, Some(0.010)),
            row(Contender::MpcObserver, 2, Some(0.030)),
            row(Contender::GprMpcObserver, 1, Some(0.040)),
            row(Contender::RlsMpcObserver, 1, None),
        ];
        let table = render(&rows, Figure::PositionRmse);
        assert!(
            table.contains("20.0") && table.contains("40.0") && table.contains("inf"),
            "{table}"
        );
        let ratios = line(&table, "geometric mean, of mpc+observer");
        assert!(ratios.contains("1.000") && ratios.contains("2.000"), "{table}");
    }

    #[test]
    fn the_worst_is_named_by_its_scenario_and_seed_against_the_better_baseline_of_that_seed() {
        let rows = [
            row(Contender::Mpc, 1, Some(0.010)),
            row(Contender::MpcObserver, 1, Some(0.020)),
            row(Contender::GprMpcObserver, 1, Some(0.017)),
            row(Contender::Mpc, 2, Some(0.030)),
            row(Contender::MpcObserver, 2, Some(0.020)),
            row(Contender::GprMpcObserver, 2, Some(0.022)),
        ];
        let table = render(&rows, Figure::PositionRmse);
        assert_eq!(
            line(&table, "worst of gpr"),
            "worst of gpr-mpc+observer cold: 1.50 in figure-eight+payload, seed 1"
        );
    }

    #[test]
    fn the_gap_is_closed_by_whoever_is_as_good_as_the_oracle() {
        let rows = [
            row(Contender::MpcObserver, 1, Some(0.020)),
            row(Contender::GprMpcObserver, 1, Some(0.014)),
            row(Contender::OracleMpc, 1, Some(0.010)),
        ];
        let table = render(&rows, Figure::PositionRmse);
        let shares: Vec<&str> =
            line(&table, "gap closed").split_whitespace().rev().take(6).collect();
        assert_eq!(shares, ["%", "100", "%", "60", "%", "0"]);
    }

    #[test]
    fn a_time_that_never_came_is_the_length_of_the_run() {
        let table = render(&[row(Contender::Mpc, 1, None)], Figure::Arrival);
        assert!(line(&table, "figure-eight+payload").contains("30.0"), "{table}");
    }
}
