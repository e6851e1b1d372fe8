//! Settings: the endpoints for watchers, the address of the live page, and the rate of each topic.

use network::telemetry::{TelemetryError, TelemetrySettings};
use process::{HasRun, Run};
use protocol::message::Exposure;
use serde::{Deserialize, Serialize};
use settings::{Check, Impossible};
use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

/// Highest rate of a topic \[Hz\].
const RATE_MAX: f64 = 1000.0;

/// Settings of the gateway.
#[derive(Debug, Clone, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// Settings that every process gets from the launcher.
    pub run: Run,
    /// Whether the plant runs on this host, so that the page can request a stop.
    #[serde(default)]
    pub has_plant: bool,
    /// The endpoints for watchers, and the robot's name.
    pub telemetry: TelemetrySettings,
    /// Highest rate of each topic.
    pub rates: Rates,
    /// Address of the live page.
    #[serde(default)]
    pub page: PageSettings,
    /// Description of the run on the page.
    #[serde(default)]
    pub about: About,
}

/// Address of the live page; off by default.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct PageSettings {
    /// Address and port, as `127.0.0.1:8080`, or `off`. Port 0 is any free port.
    pub listen: String,
}

impl Default for PageSettings {
    fn default() -> Self {
        Self { listen: "off".to_owned() }
    }
}

impl PageSettings {
    /// The address to listen on; `None` if the page is off.
    ///
    /// # Errors
    /// [`Impossible`] if it is neither an address with a port nor `off`.
    pub fn address(&self) -> Result<Option<SocketAddr>, Impossible> {
        if self.listen == "off" {
            return Ok(None);
        }
        let expected = "an address and a port such as 127.0.0.1:8080, or off";
        self.listen.parse().map(Some).map_err(|_| Impossible::new("listen", expected))
    }
}

impl Check for PageSettings {
    fn check(&self) -> Result<(), Impossible> {
        self.address().map(drop)
    }
}

/// Description of the run on the page, beside the messages. It comes from the launcher.
#[derive(Debug, Clone, Default, PartialEq, Deserialize, Serialize)]
#[serde(default, deny_unknown_fields)]
pub struct About {
    /// Name of the scenario.
    pub scenario: String,
    /// The same in one sentence.
    pub description: String,
    /// Length of the run; 0 if unknown \[s\].
    pub duration_s: f64,
    /// Half of the robot's extent, forward and to the side, for its picture \[m\].
    pub half_extent_m: [f64; 2],
    /// Each wheel for the picture: forward, left, direction in which it rolls, radius
    /// \[m, m, rad, m\].
    pub wheels: Vec<[f64; 4]>,
    /// Largest heading, either way \[rad\].
    pub heading_rad: Option<f64>,
    /// Largest speed \[m/s\].
    pub speed_mps: Option<f64>,
    /// Width of the corridor on the left of the reference \[m\].
    pub corridor_left_m: Option<f64>,
    /// Width of the corridor on its right \[m\].
    pub corridor_right_m: Option<f64>,
    /// File with the same run without learning, see [`comparison`](crate::comparison).
    pub without_learning: Option<PathBuf>,
    /// Known obstacles, zones and border.
    pub map: DrawnMap,
}

/// A map as it is drawn. Each shape is a radius, then x and y of its corners \[m\].
#[derive(Debug, Clone, Default, PartialEq, Deserialize, Serialize)]
#[serde(default, deny_unknown_fields)]
pub struct DrawnMap {
    /// Obstacles that stand.
    pub obstacles: Vec<Vec<f64>>,
    /// Areas with a speed limit.
    pub zones: Vec<Vec<f64>>,
    /// The border; none, or one.
    pub fence: Vec<Vec<f64>>,
}

impl Check for About {
    fn check(&self) -> Result<(), Impossible> {
        let Self { duration_s, heading_rad, speed_mps, corridor_left_m, corridor_right_m, .. } =
            *self;
        let limits = [
            ("duration_s", Some(duration_s)),
            ("heading_rad", heading_rad),
            ("speed_mps", speed_mps),
            ("corridor_left_m", corridor_left_m),
            ("corridor_right_m", corridor_right_m),
        ];
        let impossible = limits
            .into_iter()
            .find(|(_, value)| value.is_some_and(|value| !(value.is_finite() && value >= 0.0)));
        impossible
            .map_or(Ok(()), |(key, _)| Err(Impossible::new(key, "a finite number of at least 0")))
    }
}

/// Highest rate of each topic \[Hz\]; 0 is never.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize, Serialize)]
#[serde(default, deny_unknown_fields)]
pub struct Rates {
    /// Measured state.
    pub state: f64,
    /// The controller's plan.
    pub plan: f64,
    /// Health: at this rate for each process.
    pub health: f64,
    /// Residual of the main model.
    pub residual: f64,
    /// Learned models, complete.
    pub snapshot: f64,
    /// True state, in a simulation.
    pub truth: f64,
    /// The present goal.
    pub goal: f64,
    /// What is in the robot's way.
    pub obstacles: f64,
}

impl Default for Rates {
    fn default() -> Self {
        Self {
            state: 50.0,
            plan: 50.0,
            health: 10.0,
            residual: 10.0,
            snapshot: 1.0,
            truth: 10.0,
            goal: 10.0,
            obstacles: 10.0,
        }
    }
}

/// Lowest rate of Health for a robot that unauthenticated peers can reach \[Hz\].
const EXPOSED_HEALTH: f64 = 1.0;

impl Rates {
    /// The effective rates for a robot with this `exposure`. If unauthenticated peers can reach it,
    /// every watcher must be warned, and each Health contains the warning.
    pub(crate) fn of(self, exposure: Exposure) -> Self {
        let least = if exposure == Exposure::Closed { 0.0 } else { EXPOSED_HEALTH };
        Self { health: self.health.max(least), ..self }
    }

    /// Time between two messages at `rate`; `None` at rate 0.
    pub fn interval(rate: f64) -> Option<Duration> {
        (rate > 0.0).then(|| Duration::try_from_secs_f64(1.0 / rate).unwrap_or(Duration::MAX))
    }

    /// Time between two messages of the topic with the highest rate; at most one second.
    pub(crate) fn shortest_interval(&self) -> Duration {
        let Self { state, plan, health, residual, snapshot, truth, goal, obstacles } = *self;
        [state, plan, health, residual, snapshot, truth, goal, obstacles]
            .into_iter()
            .filter_map(Self::interval)
            .min()
            .map_or(Duration::from_secs(1), |interval| interval.min(Duration::from_secs(1)))
    }
}

impl Check for Rates {
    fn check(&self) -> Result<(), Impossible> {
        let Self { state, plan, health, residual, snapshot, truth, goal, obstacles } = *self;
        let rates = [
            ("state", state),
            ("plan", plan),
            ("health", health),
            ("residual", residual),
            ("snapshot", snapshot),
            ("truth", truth),
            ("goal", goal),
            ("obstacles", obstacles),
        ];
        let impossible = rates.into_iter().find(|(_, rate)| !(0.0..=RATE_MAX).contains(rate));
        impossible
            .map_or(Ok(()), |(topic, _)| Err(Impossible::new(topic, format!("0 to {RATE_MAX} Hz"))))
    }
}

/// Checks that the settings of the telemetry are well-formed.
///
/// # Errors
/// [`Impossible`] names the first invalid setting.
pub fn check_telemetry(telemetry: &TelemetrySettings) -> Result<(), Impossible> {
    telemetry.check().map_err(|error| match error {
        TelemetryError::Robot { .. } => {
            Impossible::new("robot", "1 to 32 characters out of a-z, 0-9, _ and -")
        }
        other => {
            Impossible::new("listen", format!("endpoints like [\"tcp/127.0.0.1:7448\"]: {other}"))
        }
    })
}

impl Check for Settings {
    fn check(&self) -> Result<(), Impossible> {
        check_telemetry(&self.telemetry).map_err(|impossible| impossible.under("telemetry"))?;
        self.rates.check().map_err(|impossible| impossible.under("rates"))?;
        self.page.check().map_err(|impossible| impossible.under("page"))?;
        self.about.check().map_err(|impossible| impossible.under("about"))
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
    fn an_impossible_rate_is_named() {
        for rate in [-1.0, f64::NAN, 1e6] {
            let refused = Rates { plan: rate, ..Rates::default() }.check();
            assert_eq!(refused, Err(Impossible::new("plan", "0 to 1000 Hz")));
        }
        assert_eq!(Rates { plan: 0.0, ..Rates::default() }.check(), Ok(()));
    }

    #[test]
    fn no_rate_hides_that_unauthenticated_peers_can_reach_the_robot() {
        let silent = Rates { health: 0.0, ..Rates::default() };
        assert_eq!(silent.of(Exposure::Closed), silent);
        assert_eq!(silent.of(Exposure::Watched).health, 1.0);
        assert_eq!(Rates::default().of(Exposure::Watched), Rates::default());
    }

    #[test]
    fn a_page_has_an_address_or_is_off() {
        let address = |listen: &str| {
            PageSettings { listen: listen.to_owned() }
                .address()
                .map_err(|impossible| impossible.key)
        };
        assert_eq!(address("127.0.0.1:0"), Ok(Some(SocketAddr::from(([127, 0, 0, 1], 0)))));
        assert_eq!((address("off"), PageSettings::default().address()), (Ok(None), Ok(None)));
        assert!(matches!(address("[::1]:8080"), Ok(Some(_))));
        for wrong in [
            "",
            "8080",
            "127.0.0.1",
            "localhost:8080",
            "127.0.0.1:99999",
            "http://127.0.0.1:80",
            "tcp/127.0.0.1:80",
            "Off",
        ] {
            assert_eq!(address(wrong), Err("listen".to_owned()), "{wrong}");
        }
        let endless = About { duration_s: f64::INFINITY, ..About::default() };
        assert_eq!(
            endless.check().map_err(|impossible| impossible.key),
            Err("duration_s".to_owned())
        );
    }

    #[test]
    fn an_impossible_endpoint_is_refused_before_any_is_opened() {
        for endpoint in [
            "",
            "127.0.0.1:7448",
            "tcp/127.0.0.1",
            "tcp/127.0.0.1:99999",
            "udp/127.0.0.1:7448",
            "tcp/:1",
        ] {
            let telemetry = TelemetrySettings {
                listen: vec![endpoint.to_owned()],
                ..TelemetrySettings::default()
            };
            let refused = check_telemetry(&telemetry).map_err(|impossible| impossible.key);
            assert_eq!(refused, Err("listen".to_owned()), "{endpoint}");
        }
        let telemetry =
            TelemetrySettings { robot: "a/b".to_owned(), ..TelemetrySettings::default() };
        assert_eq!(
            check_telemetry(&telemetry).map_err(|impossible| impossible.key),
            Err("robot".to_owned())
        );
    }
}
