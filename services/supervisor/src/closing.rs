//! `summary.json` → the table at the end of a run.

use protocol::message::{Exposure, FallbackLevel};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::fmt::{self, Display, Formatter};
use std::path::Path;
use std::{fs, io};

/// The fields of the recorder's summary that the table shows. A field without data is null.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Closing {
    arrival_s: Option<f64>,
    speed_settle_s: Option<f64>,
    steady_speed_error_mps: Option<f64>,
    #[serde(default)]
    figures_of: String,
    position_rmse_m: Option<f64>,
    position_max_m: Option<f64>,
    tick_p50_us: Option<f64>,
    tick_p99_us: Option<f64>,
    tick_max_us: Option<f64>,
    periods: u64,
    periods_missed: u64,
    fallback_levels: BTreeMap<String, u64>,
    #[serde(default)]
    stops: Vec<Stopped>,
    world_stalled_s: f64,
    snapshots_published: u64,
    snapshots_adopted: u64,
    losses: BTreeMap<String, BTreeMap<String, u64>>,
    #[serde(default)]
    told: Vec<String>,
    exposure: String,
}

/// One stop of the gate.
#[derive(Debug, Clone, PartialEq, Deserialize)]
struct Stopped {
    at_s: f64,
    reason: String,
    resumed_s: Option<f64>,
}

impl Closing {
    /// Reads the summary of the run in `folder`.
    ///
    /// # Errors
    /// If it does not exist or is incomplete.
    pub fn read(folder: &Path) -> io::Result<Self> {
        Ok(serde_json::from_slice(&fs::read(folder.join("summary.json"))?)?)
    }
}

impl Display for Closing {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let metres = |value| figure(value, 3, "m");
        let micros = |value| figure(value, 0, "µs");
        writeln!(
            f,
            "  arrival             {}",
            self.arrival_s.map_or_else(|| "never".into(), |time| figure(Some(time), 1, "s"))
        )?;
        writeln!(
            f,
            "  speed settled       {}",
            self.speed_settle_s.map_or_else(|| "never".into(), |time| figure(Some(time), 1, "s"))
        )?;
        writeln!(f, "  steady speed error  {}", figure(self.steady_speed_error_mps, 3, "m/s"))?;
        writeln!(
            f,
            "  position error      {} rms, {} at most{}",
            metres(self.position_rmse_m),
            metres(self.position_max_m),
            if self.figures_of == "measured" { ", as measured" } else { "" }
        )?;
        let [half, most, all] = [self.tick_p50_us, self.tick_p99_us, self.tick_max_us].map(micros);
        writeln!(f, "  control tick        {half} p50, {most} p99, {all} at most")?;
        let on_fallback_level = |fallback_level: &&FallbackLevel| {
            self.fallback_levels.get(fallback_level.text()).is_some_and(|&periods| periods > 0)
        };
        let fallback_levels =
            FallbackLevel::ALL.iter().filter(on_fallback_level).map(|fallback_level| {
                format!(
                    "{fallback_level} {}",
                    self.fallback_levels.get(fallback_level.text()).copied().unwrap_or(0)
                )
            });
        writeln!(
            f,
            "  periods             {}, {} missed ({})",
            self.periods,
            self.periods_missed,
            list(fallback_levels)
        )?;
        for Stopped { at_s, reason, resumed_s } in &self.stops {
            let until = resumed_s
                .map_or_else(|| "to the end".into(), |time| format!("resumed at {time:.1} s"));
            writeln!(f, "  STOPPED             {reason} at {at_s:.1} s, {until}")?;
        }
        if self.world_stalled_s > 0.0 {
            writeln!(
                f,
                "  world stood still   {:.3} s, \
                 in which the machine suspended the simulator",
                self.world_stalled_s
            )?;
        }
        writeln!(
            f,
            "  models              {} published, {} adopted",
            self.snapshots_published, self.snapshots_adopted
        )?;
        let lost = self
            .losses
            .iter()
            .map(|(topic, readers)| (topic, readers.values().copied().fold(0, u64::saturating_add)))
            .filter(|(_, lost)| *lost > 0);
        write!(
            f,
            "  messages lost       {}",
            list(lost.map(|(topic, lost)| format!("{topic} {lost}")))
        )?;
        for told in &self.told {
            write!(f, "\n  reported            {told}")?;
        }
        if self.exposure == Exposure::Closed.text() {
            Ok(())
        } else {
            write!(f, "\n  INSECURE            {}", self.exposure)
        }
    }
}

fn figure(value: Option<f64>, decimals: usize, unit: &str) -> String {
    value.map_or_else(|| "-".into(), |value| format!("{value:.decimals$} {unit}"))
}

fn list(items: impl Iterator<Item = String>) -> String {
    let items: Vec<String> = items.collect();
    if items.is_empty() { "none".into() } else { items.join(", ") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_shows_the_summary() -> io::Result<()> {
        let folder = tempfile::tempdir()?;
        let summary = concat!(
            r#"{"arrival_s": 1.3, "speed_settle_s": null, "#,
            r#""steady_speed_error_mps": 0.0412, "position_rmse_m": 0.012,"#,
            "\n            ",
            r#""position_max_m": 0.0431, "heading_rmse_rad": null, "tick_p50_us": 212.4, "#,
            r#""tick_p99_us": 400.0, "tick_max_us": 801.0,"#,
            "\n            ",
            r#""periods": 250, "periods_missed": 1, "fallback_levels": {"brake": 1, "#,
            r#""fresh plan": 249, "simple controller": 0}, "world_stalled_s": 0.0, "#,
            r#""snapshots_published": 5,"#,
            "\n            ",
            r#""snapshots_adopted": 4, "losses": {"plan": {"recorder": 2, "launcher": 1}, "#,
            r#""state": {"recorder": 0}}, "exposure": "closed"}"#,
        );
        fs::write(folder.path().join("summary.json"), summary)?;
        let expected = "  arrival             1.3 s
  speed settled       never
  steady speed error  0.041 m/s
  position error      0.012 m rms, 0.043 m at most
  control tick        212 µs p50, 400 µs p99, 801 µs at most
  periods             250, 1 missed (fresh plan 249, brake 1)
  models              5 published, 4 adopted
  messages lost       plan 3";
        assert_eq!(Closing::read(folder.path())?.to_string(), expected);
        fs::write(
            folder.path().join("summary.json"),
            summary.replace("closed", "strangers can drive"),
        )?;
        let expected = format!("{expected}\n  INSECURE            strangers can drive");
        assert_eq!(Closing::read(folder.path())?.to_string(), expected);
        let stops = r#""stops": [{"at_s": 3.21, "reason": "position error", "resumed_s": 5.0},
            {"at_s": 9.0, "reason": "heading error", "resumed_s": null}], "fallback_levels""#;
        fs::write(
            folder.path().join("summary.json"),
            summary.replace("\"fallback_levels\"", stops),
        )?;
        let shown = Closing::read(folder.path())?.to_string();
        assert!(
            shown.contains(
                "\n  STOPPED             position error at 3.2 s, resumed at 5.0 s\
                 \n  STOPPED             heading error at 9.0 s, to the end\n"
            ),
            "{shown}"
        );
        let summary =
            summary.replace("\"exposure\"", "\"told\": [\"controller: slow\"], \"exposure\"");
        let summary = summary
            .replace("\"position_rmse_m\"", "\"figures_of\": \"measured\", \"position_rmse_m\"");
        fs::write(folder.path().join("summary.json"), summary)?;
        let shown = Closing::read(folder.path())?.to_string();
        assert!(shown.ends_with("\n  reported            controller: slow"), "{shown}");
        assert!(shown.contains("0.043 m at most, as measured\n"), "{shown}");
        Ok(())
    }
}
