//! Rows → the table that is printed.

use super::Row;
use std::fmt::Write;

/// After n trials without a failure, the probability of a failure is below 3 / n with 95 %
/// confidence.
const RULE_OF_THREE: f64 = 3.0;

/// All rows, and their summary. `may_go_first` is whether the witness runs with the highest
/// priority; the summary reports it.
pub(super) fn render(rows: &[Row], may_go_first: bool) -> String {
    let mut text = String::new();
    let _ = writeln!(
        text,
        "{:<18} {:<17} {:<14} {:>10} {:>10} {:>14} {:>13} {:>8} {:>9}",
        "fault",
        "target",
        "carrier",
        "injections",
        "violations",
        "worst reaction",
        "worst restart",
        "tracking",
        "95% bound"
    );
    for row in rows {
        let reaction =
            row.worst_reaction_periods.map_or("-".to_owned(), |periods| format!("{periods:.2} T"));
        let restart =
            row.worst_restart_s.map_or("-".to_owned(), |seconds| format!("{seconds:.2} s"));
        let tracking =
            row.tracking_share.map_or("-".to_owned(), |share| format!("{:.0} %", 100.0 * share));
        let bound = if row.violations == 0 && row.injections > 0 {
            percent(RULE_OF_THREE / row.injections as f64)
        } else {
            "-".to_owned()
        };
        let _ = writeln!(
            text,
            "{:<18} {:<17} {:<14} {:>10} {:>10} {reaction:>14} {restart:>13} \
             {tracking:>8} {bound:>9}",
            row.fault,
            row.target,
            row.carrier.name(),
            row.injections,
            row.violations
        );
    }
    let (injections, violations): (u64, usize) =
        rows.iter().fold((0, 0), |sum, row| (sum.0 + row.injections, sum.1 + row.violations));
    let _ = write!(
        text,
        "\n{} exercises, {injections} injections, {violations} violations",
        rows.len()
    );
    let excused: usize = rows.iter().map(|row| row.excused_periods).sum();
    if excused > 0 {
        let witness = if may_go_first {
            "a witness of higher priority than the graph"
        } else {
            "a witness, which has no higher priority here"
        };
        let _ = write!(
            text,
            "\n{excused} periods below a fresh plan are excused: \
             the machine suspended {witness} at the same time"
        );
    }
    for (row, why) in rows.iter().filter_map(|row| Some((row, row.impossible?))) {
        let _ = write!(text, "\nnot done: {} of {}: {why}", row.fault, row.target);
    }
    for (row, note) in rows.iter().flat_map(|row| row.notes.iter().map(move |note| (row, note))) {
        let _ =
            write!(text, "\n{} of {} over {}: {note}", row.fault, row.target, row.carrier.name());
    }
    for kept in rows.iter().filter_map(|row| row.kept.as_ref()) {
        let _ = write!(text, "\nkept: {}", kept.display());
    }
    text
}

/// A probability as a percentage.
fn percent(probability: f64) -> String {
    if probability < 0.01 {
        format!("{:.4} %", 100.0 * probability)
    } else {
        format!("{:.0} %", 100.0 * probability.min(1.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::catalogue::Carrier;
    use std::path::PathBuf;

    #[test]
    fn a_row_with_violations_has_no_bound_and_names_its_folder() {
        let good = Row {
            fault: "kill",
            target: "plant",
            carrier: Carrier::Hosts,
            injections: 300,
            violations: 0,
            worst_reaction_periods: Some(2.5),
            worst_restart_s: Some(0.14),
            tracking_share: Some(0.625),
            seed: 1,
            excused_periods: 3,
            impossible: None,
            notes: vec!["two network namespaces".to_owned()],
            found: Vec::new(),
            kept: None,
        };
        let bad = Row { violations: 2, kept: Some(PathBuf::from("runs/drill/x")), ..good.clone() };
        let text = render(&[good, bad], true);
        assert!(text.contains("kill of plant over two hosts: two network namespaces"), "{text}");
        assert!(text.contains("6 periods below a fresh plan are excused"), "{text}");
        let lines: Vec<&str> = text.lines().collect();
        assert!(
            lines[1].contains("2.50 T")
                && lines[1].contains(" 62 %")
                && lines[1].contains("0.14 s")
                && lines[1].ends_with("1 %"),
            "{text}"
        );
        assert!(lines[2].ends_with('-'), "{text}");
        assert!(
            text.contains("2 exercises, 600 injections, 2 violations")
                && text.ends_with("kept: runs/drill/x"),
            "{text}"
        );
    }
}
