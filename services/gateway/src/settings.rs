//! What a person may set: where watchers connect, and how often each topic is shown.

use process::{HasRun, Run};
use protocol::telemetry::{TelemetryError, TelemetrySettings};
use serde::{Deserialize, Serialize};
use settings::{Check, Impossible};
use std::time::Duration;

/// Highest rate of a topic \[Hz\].
const RATE_MAX: f64 = 1000.0;

/// Settings of the gateway.
#[derive(Debug, Clone, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// What the launcher tells every process.
    pub run: Run,
    /// Where watchers connect, and how the robot is called.
    pub telemetry: TelemetrySettings,
    /// How often each topic is shown at most.
    pub rates: Rates,
}

/// How often each topic is shown at most \[Hz\]; 0 is never.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize, Serialize)]
#[serde(default, deny_unknown_fields)]
pub struct Rates {
    /// Measured state.
    pub state: f64,
    /// What the controller intends.
    pub plan: f64,
    /// How each process is: so often for each of them.
    pub health: f64,
    /// What the main model got wrong.
    pub residual: f64,
    /// Learned models, whole.
    pub snapshot: f64,
    /// What is really the case, in a simulation.
    pub truth: f64,
}

impl Default for Rates {
    fn default() -> Self {
        Self { state: 50.0, plan: 50.0, health: 10.0, residual: 10.0, snapshot: 1.0, truth: 10.0 }
    }
}

impl Rates {
    /// Time between two messages at `rate`, none if there shall be none.
    pub fn interval(rate: f64) -> Option<Duration> {
        (rate > 0.0).then(|| Duration::try_from_secs_f64(1.0 / rate).unwrap_or(Duration::MAX))
    }

    /// Time between two messages of the topic that is shown most often; a second at most.
    pub(crate) fn shortest_interval(&self) -> Duration {
        let rates = [self.state, self.plan, self.health, self.residual, self.snapshot, self.truth];
        rates.into_iter().filter_map(Self::interval).min().map_or(Duration::from_secs(1), |interval| interval.min(Duration::from_secs(1)))
    }
}

impl Check for Rates {
    fn check(&self) -> Result<(), Impossible> {
        let Self { state, plan, health, residual, snapshot, truth } = *self;
        let rates =
            [("state", state), ("plan", plan), ("health", health), ("residual", residual), ("snapshot", snapshot), ("truth", truth)];
        let impossible = rates.into_iter().find(|(_, rate)| !(0.0..=RATE_MAX).contains(rate));
        impossible.map_or(Ok(()), |(topic, _)| Err(Impossible::new(topic, format!("0 to {RATE_MAX} Hz"))))
    }
}

/// Fails unless the settings of the telemetry are well-formed.
///
/// # Errors
/// [`Impossible`] names the first that is not.
pub fn check_telemetry(telemetry: &TelemetrySettings) -> Result<(), Impossible> {
    telemetry.check().map_err(|error| match error {
        TelemetryError::Robot { .. } => Impossible::new("robot", "1 to 32 characters out of a-z, 0-9, _ and -"),
        other => Impossible::new("listen", format!("endpoints like [\"tcp/127.0.0.1:7448\"]: {other}")),
    })
}

impl Check for Settings {
    fn check(&self) -> Result<(), Impossible> {
        check_telemetry(&self.telemetry).map_err(|impossible| impossible.under("telemetry"))?;
        self.rates.check().map_err(|impossible| impossible.under("rates"))
    }
}

impl HasRun for Settings {
    fn run(&self) -> &Run {
        &self.run
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rate_that_cannot_be_is_named() {
        for rate in [-1.0, f64::NAN, 1e6] {
            let refused = Rates { plan: rate, ..Rates::default() }.check();
            assert_eq!(refused, Err(Impossible::new("plan", "0 to 1000 Hz")));
        }
        assert_eq!(Rates { plan: 0.0, ..Rates::default() }.check(), Ok(()));
    }

    #[test]
    fn an_endpoint_that_cannot_be_is_refused_before_anything_is_opened() {
        for endpoint in ["", "127.0.0.1:7448", "tcp/127.0.0.1", "tcp/127.0.0.1:99999", "udp/127.0.0.1:7448", "tcp/:1"] {
            let telemetry = TelemetrySettings { listen: vec![endpoint.to_owned()], ..TelemetrySettings::default() };
            let refused = check_telemetry(&telemetry).map_err(|impossible| impossible.key);
            assert_eq!(refused, Err("listen".to_owned()), "{endpoint}");
        }
        let telemetry = TelemetrySettings { robot: "a/b".to_owned(), ..TelemetrySettings::default() };
        assert_eq!(check_telemetry(&telemetry).map_err(|impossible| impossible.key), Err("robot".to_owned()));
    }
}
