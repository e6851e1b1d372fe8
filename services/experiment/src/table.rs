//! Rows → the table that is printed: one figure by scenario, contender and start, and the summary.
//! A losing cell is printed like a winning one.
//!
//! ```text
//! geometric mean, of b      exp(mean over scenarios of ln(x / b)),  x and b means over the seeds
//! gap closed                Σ(observer − x) / Σ(observer − oracle)  over the scenarios
//! share of the bar          x / (1.05 b + min(2 mm, 0.2 b)), b the least of all that learn nothing
//! ```
//! The no-harm bar is computed for the means over the seeds, and for every seed separately. A start
//! is compared with baselines of the same start, where these remember an earlier run.

use super::contender::Contender;
use super::figure::Figure;
use super::trial::{Row, Start};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;

/// The no-harm bar \[m\] for a best baseline of `best` \[m\].
fn bar(best: f64) -> f64 {
    1.05 * best + (0.2 * best).min(0.002)
}

/// A column compared with the no-harm bar.
struct Harm<'a> {
    /// Largest share of the bar in a cell, and the scenario of that cell.
    cell: (f64, &'a str),
    /// Number of cells above the bar, and of trials.
    above: [usize; 2],
    /// Number of all cells, and of all trials.
    of: [usize; 2],
}

/// A contender, and what it knows at the start.
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
            // A figure that a row cannot have is left out.
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

    /// The column of a contender with that start. A contender without memory has one column.
    fn baseline(&self, contender: Contender, start: Start) -> Option<Column> {
        let mut columns = self.columns.iter().copied().filter(|column| column.0 == contender);
        columns.find(|column| column.1 == start || !contender.remembers())
    }

    fn geometric_mean(&self, column: Column, contender: Contender) -> Option<f64> {
        let baseline = self.baseline(contender, column.1)?;
        let ratios = self.scenarios.iter().filter_map(|scenario| {
            Some((self.mean(scenario, column)? / self.mean(scenario, baseline)?).ln())
        });
        let (count, sum) = ratios.fold((0, 0.0), |(count, sum), ratio| (count + 1, sum + ratio));
        (count > 0).then(|| (sum / f64::from(count)).exp())
    }

    fn gap_closed(&self, column: Column) -> Option<f64> {
        let (observer, oracle) = (
            self.baseline(Contender::MpcObserver, column.1)?,
            self.baseline(Contender::OracleMpc, column.1)?,
        );
        let gaps = self.scenarios.iter().filter_map(|scenario| {
            let from = self.mean(scenario, observer)?;
            Some((from - self.mean(scenario, column)?, from - self.mean(scenario, oracle)?))
        });
        let (closed, whole) =
            gaps.fold((0.0, 0.0), |(closed, whole), gap| (closed + gap.0, whole + gap.1));
        (whole != 0.0).then(|| closed / whole)
    }

    /// The least of the values of `of` over the baselines with that start.
    fn best(&self, start: Start, of: impl Fn(Column) -> Option<f64>) -> Option<f64> {
        let is_baseline = |column: &&Column| {
            let (contender, its_start) = **column;
            let is_same = its_start == start || !contender.remembers();
            is_same && !contender.learns() && !contender.is_bound()
        };
        let values = self.columns.iter().filter(is_baseline).filter_map(|&column| of(column));
        values.reduce(f64::min)
    }

    /// Comparison with the no-harm bar; none without a baseline.
    fn harm(&self, column: Column) -> Option<Harm<'a>> {
        let mut harm = Harm { cell: (0.0, ""), above: [0; 2], of: [0; 2] };
        for &scenario in &self.scenarios {
            let cell = self.mean(scenario, column);
            let best = self.best(column.1, |column| self.mean(scenario, column));
            let (Some(cell), Some(best)) = (cell, best) else { continue };
            let share = cell / bar(best);
            if share > harm.cell.0 {
                harm.cell = (share, scenario);
            }
            harm.of[0] += 1;
            harm.above[0] += usize::from(share > 1.0);
            let of = |seed: u64, column| {
                self.values.get(&(scenario, column)).and_then(|seeds| seeds.get(&seed)).copied()
            };
            for (&seed, value) in self.values.get(&(scenario, column)).into_iter().flatten() {
                let Some(best) = self.best(column.1, |column| of(seed, column)) else { continue };
                harm.of[1] += 1;
                harm.above[1] += usize::from(*value > bar(best));
            }
        }
        (harm.of[0] > 0).then_some(harm)
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
    line("start", &|(contender, start)| contender.remembers().then(|| start.to_string()));
    for scenario in &cells.scenarios {
        line(scenario, &|column| {
            cells.mean(scenario, column).map(|mean| format!("{:.1}", scale * mean))
        });
    }
    for contender in [
        Contender::Mpc,
        Contender::MpcObserver,
        Contender::MpcKalman,
        Contender::RlsMpcObserver,
        Contender::PhysicsMpcObserver,
    ] {
        if !cells.columns.iter().any(|column| column.0 == contender) {
            continue;
        }
        line(&format!("geometric mean, of {contender}"), &|column| {
            cells.geometric_mean(column, contender).map(|ratio| format!("{ratio:.3}"))
        });
    }
    if figure != Figure::PositionRmse {
        return out;
    }
    line("gap closed from mpc+observer to oracle", &|column| {
        cells.gap_closed(column).map(|share| format!("{:.0} %", 100.0 * share))
    });
    let harm = |column: Column| cells.harm(column);
    line("largest share of the bar of no harm", &|column| {
        harm(column).map(|harm| format!("{:.2}", harm.cell.0))
    });
    line("cells above it", &|column| {
        harm(column).map(|harm| format!("{} of {}", harm.above[0], harm.of[0]))
    });
    line("trials above it", &|column| {
        harm(column).map(|harm| format!("{} of {}", harm.above[1], harm.of[1]))
    });
    for &(contender, start) in &cells.columns {
        if let Some(Harm { cell: (share, scenario), .. }) = harm((contender, start)) {
            let known = if contender.remembers() { format!(" {start}") } else { String::new() };
            let _ = write!(out, "\nlargest share of {contender}{known}: {share:.2} in {scenario}");
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
            arrival_by_band_s: BTreeMap::new(),
            figures_of: "truth",
            laps_rmse_m: Vec::new(),
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
            interval: None,
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
    fn harm_is_counted_against_the_best_baseline_without_learning() {
        let rows = [
            row(Contender::Mpc, 1, Some(0.010)),
            row(Contender::MpcObserver, 1, Some(0.020)),
            row(Contender::GprMpcObserver, 1, Some(0.024)),
            row(Contender::Mpc, 2, Some(0.030)),
            row(Contender::RlsMpcObserver, 2, Some(0.020)),
            row(Contender::GprMpcObserver, 2, Some(0.022)),
            row(Contender::OracleMpc, 2, Some(0.001)),
        ];
        let table = render(&rows, Figure::PositionRmse);
        // The baselines have a mean of 20 mm, and the learner one of 23 mm: the bar is 23 mm.
        assert_eq!(
            line(&table, "largest share of gpr"),
            "largest share of gpr-mpc+observer cold: 1.00 in figure-eight+payload"
        );
        let ours = |name| line(&table, name).split("  ").map(str::trim).filter(|it| !it.is_empty());
        let learners = |name| ours(name).nth(4).map(str::to_owned);
        assert_eq!(learners("trials above it").as_deref(), Some("1 of 2"), "{table}");
    }

    #[test]
    fn a_warm_start_is_compared_with_warm_least_squares() {
        let warm = |controller, rmse| Row { start: Start::Warm, ..row(controller, 1, Some(rmse)) };
        let rows = [
            row(Contender::MpcObserver, 1, Some(0.040)),
            row(Contender::RlsMpcObserver, 1, Some(0.020)),
            warm(Contender::RlsMpcObserver, 0.010),
            row(Contender::GprMpcObserver, 1, Some(0.020)),
            warm(Contender::GprMpcObserver, 0.015),
        ];
        let table = render(&rows, Figure::PositionRmse);
        let ratios = |name| {
            let line = line(&table, name).split_whitespace();
            line.filter_map(|word| word.parse().ok()).collect::<Vec<f64>>()
        };
        assert_eq!(ratios("geometric mean, of rls"), [2.0, 1.0, 1.0, 1.0, 1.5], "{table}");
        assert_eq!(ratios("geometric mean, of mpc+o"), [1.0, 0.5, 0.25, 0.5, 0.375], "{table}");
        let shares = ratios("largest share of the bar");
        assert!((shares[4] - 0.015 / bar(0.010)).abs() < 0.01, "{table}");
    }

    #[test]
    fn the_margin_is_a_fifth_of_a_small_error_and_two_millimetres_of_a_large_one() {
        for (best, expected) in [(0.001, 0.00125), (0.1, 0.107)] {
            assert!((bar(best) - expected).abs() < 1e-12);
        }
    }

    #[test]
    fn the_gap_is_closed_by_a_contender_as_good_as_the_oracle() {
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
