//! Rows → the table that is printed: position RMSE by scenario and contender, and what it comes to. A losing cell looks like a winning one.

use super::contender::Contender;
use super::trial::{Row, Start};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;

/// Scenario, contender and start.
type Cell<'a> = (&'a str, Contender, Start);

/// The table of `rows`.
pub(super) fn render(rows: &[Row]) -> String {
    let mut cells: BTreeMap<Cell<'_>, Vec<f64>> = BTreeMap::new();
    for row in rows {
        // A run that never was within reach of its reference is as bad as can be told.
        cells.entry((&row.scenario, row.controller, row.start)).or_default().push(row.position_rmse_m.unwrap_or(f64::INFINITY));
    }
    let means: BTreeMap<Cell<'_>, f64> =
        cells.iter().map(|(cell, values)| (*cell, values.iter().sum::<f64>() / values.len() as f64)).collect();
    let columns: BTreeSet<(Contender, Start)> = cells.keys().map(|&(_, contender, start)| (contender, start)).collect();
    let scenarios: BTreeSet<&str> = cells.keys().map(|&(scenario, ..)| scenario).collect();
    let title = |(contender, start): &(Contender, Start)| match start {
        Start::Cold => contender.to_string(),
        Start::Warm => format!("{contender} warm"),
        Start::Stale => format!("{contender} stale"),
    };
    let width = scenarios.iter().map(|name| name.len()).max().unwrap_or(0).max(40);
    let mut out = String::from("position RMSE, mean over the seeds [mm]\n");
    // Writing to a String never fails.
    let _ = write!(out, "{:width$}", "");
    for column in &columns {
        let _ = write!(out, "  {:>16}", title(column));
    }
    for scenario in &scenarios {
        let _ = write!(out, "\n{scenario:width$}");
        for (contender, start) in &columns {
            let cell = means.get(&(*scenario, *contender, *start)).map_or_else(|| "-".into(), |mean| format!("{:.1}", 1e3 * mean));
            let _ = write!(out, "  {cell:>16}");
        }
    }
    for baseline in [Contender::Mpc, Contender::MpcObserver, Contender::RlsMpcObserver] {
        let Some(&(_, start)) = columns.iter().find(|(contender, _)| *contender == baseline) else { continue };
        let _ = write!(out, "\n{:width$}", format!("geometric mean, of {baseline}"));
        for (contender, its_start) in &columns {
            let ratios = scenarios.iter().filter_map(|scenario| {
                Some((means.get(&(*scenario, *contender, *its_start))? / means.get(&(*scenario, baseline, start))?).ln())
            });
            let (count, sum) = ratios.fold((0, 0.0), |(count, sum), ratio| (count + 1, sum + ratio));
            let _ = write!(out, "  {:>16.3}", (sum / f64::from(count)).exp());
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
            arrival_s: None,
            speed_settle_s: None,
            steady_speed_error_mps: None,
            position_rmse_m,
            position_max_m: None,
            heading_rmse_rad: None,
            input_effort: 0.0,
            constraint_violations: 0,
            tick_p50_us: None,
            tick_p99_us: None,
        }
    }

    #[test]
    fn a_losing_cell_is_printed_like_a_winning_one() {
        let rows = [
            row(Contender::MpcObserver, 1, Some(0.010)),
            row(Contender::MpcObserver, 2, Some(0.030)),
            row(Contender::GprMpcObserver, 1, Some(0.040)),
            row(Contender::RlsMpcObserver, 1, None),
        ];
        let table = render(&rows);
        assert!(table.contains("20.0") && table.contains("40.0") && table.contains("inf"), "{table}");
        let ratios = table.lines().find(|line| line.contains("geometric mean, of mpc+observer")).unwrap_or_default();
        assert!(ratios.contains("1.000") && ratios.contains("2.000"), "{table}");
    }
}
