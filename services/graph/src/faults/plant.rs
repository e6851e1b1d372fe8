//! Faults of the robot itself, and of the floor under it: changes of the world that a scenario
//! describes.

use plant_sim::obstacles::{Appearing, ObstacleSettings};
use plant_sim::truth::{
    Fault, Payload, Pressed, Slippery, Stuck, StuckSensor, Truth, Wheel, WheelSlip,
};
use robot::Point;
use serde::Deserialize;
use settings::Impossible;

/// Grip of a floor without wheel slip in the scenario: rubber on a clean floor \[1\].
const DRY_GRIP: f64 = 0.8;
/// Rim speed relative to the floor at which the force is tanh(1) of its maximum \[m/s\].
const SLIP_SPEED_SCALE_MPS: f64 = 0.05;

/// A fault of the robot.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlantFault {
    /// Kind.
    pub kind: PlantFaultKind,
    /// Begin, after the plant's start in its own time \[s\].
    pub from_s: f64,
    /// Duration; to the end of the run if absent \[ms\].
    #[serde(default)]
    pub millis: Option<u64>,
    /// For `weak-motor` and `dead-motor`: the wheel.
    #[serde(default)]
    pub wheel: Option<Wheel>,
    /// For `weak-motor`: the fraction of its torque that remains.
    #[serde(default)]
    pub gain: Option<f64>,
    /// For `slip`: the fraction of the floor's grip that remains.
    #[serde(default)]
    pub grip: Option<f64>,
    /// For `payload`: its mass \[kg\].
    #[serde(default)]
    pub mass_kg: Option<f64>,
    /// For `stuck-sensor`: the sensor.
    #[serde(default)]
    pub sensor: Option<StuckSensor>,
    /// For `obstacle`: its centre, forward and left of the robot's centre when it appears \[m\].
    #[serde(default)]
    pub at_m: Option<Point>,
    /// For `obstacle`: its radius \[m\].
    #[serde(default)]
    pub radius_m: Option<f64>,
}

/// Kinds of faults of a robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PlantFaultKind {
    /// A motor gives only a part of its torque.
    WeakMotor,
    /// A motor gives no torque.
    DeadMotor,
    /// The floor is slippery everywhere.
    Slip,
    /// The robot carries a payload, in the middle between its wheels.
    Payload,
    /// A sensor repeats its last value.
    StuckSensor,
    /// The emergency stop is pressed.
    EmergencyStop,
    /// A disc appears beside or on the robot, and stands there.
    Obstacle,
}

impl PlantFaultKind {
    /// Name in files and logs.
    pub const fn name(self) -> &'static str {
        match self {
            Self::WeakMotor => "weak-motor",
            Self::DeadMotor => "dead-motor",
            Self::Slip => "slip",
            Self::Payload => "payload",
            Self::StuckSensor => "stuck-sensor",
            Self::EmergencyStop => "emergency-stop",
            Self::Obstacle => "obstacle",
        }
    }
}

impl PlantFault {
    /// Adds the fault to `world`, as a scenario describes it.
    ///
    /// # Errors
    /// [`Impossible`] names the key that contradicts the faults of the world itself.
    pub(super) fn happen_in(&self, world: &mut Truth) -> Result<(), Impossible> {
        let (from_s, until_s) =
            (self.from_s, self.millis.map(|millis| self.from_s + millis as f64 * 1e-3));
        let needed = |key: &str| Impossible::new(key, format!("it for {}", self.kind.name()));
        match self.kind {
            PlantFaultKind::WeakMotor | PlantFaultKind::DeadMotor => {
                let gain = if self.kind == PlantFaultKind::DeadMotor {
                    0.0
                } else {
                    self.gain.ok_or_else(|| needed("gain"))?
                };
                let wheel = self.wheel.ok_or_else(|| needed("wheel"))?;
                world.faults.push(Fault { wheel, gain, at_s: from_s, until_s });
            }
            PlantFaultKind::Slip => {
                let grip_factor = self.grip.ok_or_else(|| needed("grip"))?;
                world.wheel_slip.get_or_insert(WheelSlip {
                    grip: DRY_GRIP,
                    slip_speed_scale_mps: SLIP_SPEED_SCALE_MPS,
                });
                world.slippery.push(Slippery { grip_factor, from_s, until_s });
            }
            PlantFaultKind::Payload => {
                if world.payload.is_some() {
                    return Err(Impossible::new(
                        "kind",
                        "no payload where the scenario, or a fault before, has one already",
                    ));
                }
                let mass_kg = self.mass_kg.ok_or_else(|| needed("mass_kg"))?;
                world.payload = Some(Payload {
                    mass_kg,
                    yaw_inertia_kg_m2: 0.0,
                    offset_m: [0.0; 2],
                    at_s: from_s,
                    until_s,
                });
            }
            PlantFaultKind::StuckSensor => {
                let sensor = self.sensor.ok_or_else(|| needed("sensor"))?;
                world.stuck.push(Stuck { sensor, from_s, until_s });
            }
            PlantFaultKind::EmergencyStop => world.pressed.push(Pressed { from_s, until_s }),
            // It is no part of the robot: see `happen_among`.
            PlantFaultKind::Obstacle => {}
        }
        Ok(())
    }

    /// Adds the fault to the obstacles of the world, if it is one.
    ///
    /// # Errors
    /// [`Impossible`] if the robot has no sensor for obstacles.
    pub(super) fn happen_among(
        &self,
        obstacles: Option<&mut ObstacleSettings>,
    ) -> Result<(), Impossible> {
        let (PlantFaultKind::Obstacle, Some(at_m), Some(radius_m)) =
            (self.kind, self.at_m, self.radius_m)
        else {
            return Ok(());
        };
        let Some(obstacles) = obstacles else {
            return Err(Impossible::new("kind", "a scenario with [obstacles]: a sensor for them"));
        };
        let seconds = self.millis.map_or(f64::INFINITY, |millis| millis as f64 * 1e-3);
        let (from_s, until_s) = (self.from_s, (self.from_s + seconds).min(f64::MAX));
        obstacles.appearing.push(Appearing { at_m, radius_m, from_s, until_s });
        Ok(())
    }

    /// Whether such a fault is possible in any world.
    pub(super) fn check(&self) -> Result<(), Impossible> {
        let kind = self.kind;
        let motor = matches!(kind, PlantFaultKind::WeakMotor | PlantFaultKind::DeadMotor);
        for (key, is, wanted) in [
            ("wheel", self.wheel.is_some(), motor),
            ("gain", self.gain.is_some(), kind == PlantFaultKind::WeakMotor),
            ("grip", self.grip.is_some(), kind == PlantFaultKind::Slip),
            ("mass_kg", self.mass_kg.is_some(), kind == PlantFaultKind::Payload),
            ("sensor", self.sensor.is_some(), kind == PlantFaultKind::StuckSensor),
            ("at_m", self.at_m.is_some(), kind == PlantFaultKind::Obstacle),
            ("radius_m", self.radius_m.is_some(), kind == PlantFaultKind::Obstacle),
        ] {
            match (is, wanted) {
                (true, false) => {
                    return Err(Impossible::new(key, format!("no such key for {}", kind.name())));
                }
                (false, true) => {
                    return Err(Impossible::new(key, format!("it for {}", kind.name())));
                }
                _ => {}
            }
        }
        for (key, share) in [("gain", self.gain), ("grip", self.grip)] {
            if share.is_some_and(|share| !(0.0..=1.0).contains(&share)) {
                return Err(Impossible::new(key, "a factor from 0 to 1"));
            }
        }
        if self.mass_kg.is_some_and(|mass| !(mass.is_finite() && mass >= 0.0)) {
            return Err(Impossible::new("mass_kg", "a finite mass that is not negative"));
        }
        if !(self.from_s.is_finite() && self.from_s >= 0.0) {
            return Err(Impossible::new("from_s", "a finite time that is not negative"));
        }
        if self.millis == Some(0) {
            return Err(Impossible::new(
                "millis",
                "at least 1 ms, or no key for an unlimited time",
            ));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::FaultsFile;
    use super::*;
    use std::path::Path;

    fn read(text: &str) -> Result<FaultsFile, String> {
        settings::parse::<FaultsFile>(text, Path::new("f.toml")).map_err(|error| error.to_string())
    }

    #[test]
    fn a_fault_of_the_robot_changes_the_world_as_a_scenario_does() -> Result<(), String> {
        let world = |text: &str| {
            let world = read(text)?.in_world(Some(&Truth::default()));
            world.map(Option::unwrap_or_default).map_err(|impossible| impossible.key)
        };
        let dead = world(
            "[[plant]]\nkind = \"dead-motor\"\nwheel = \"rear-left\"\nfrom_s = 2.0\nmillis = 500\n",
        )?;
        let fault = Fault { wheel: Wheel::RearLeft, gain: 0.0, at_s: 2.0, until_s: Some(2.5) };
        assert_eq!(dead, Truth { faults: vec![fault], ..Truth::default() });
        let slippery = world("[[plant]]\nkind = \"slip\"\ngrip = 0.3\nfrom_s = 2.0\n")?;
        assert_eq!((slippery.slippery.len(), slippery.wheel_slip.is_some()), (1, true));
        let load = "[[plant]]\nkind = \"payload\"\nmass_kg = 5.0\nfrom_s = 2.0\n";
        assert_eq!(world(load)?.payload.map(|payload| payload.mass_kg), Some(5.0));
        assert_eq!(world(&format!("{load}{load}")), Err("plant.1.kind".to_owned()));
        let pressed = world("[[plant]]\nkind = \"emergency-stop\"\nfrom_s = 2.0\nmillis = 500\n")?;
        assert_eq!(pressed.pressed, [Pressed { from_s: 2.0, until_s: Some(2.5) }]);
        Ok(())
    }

    #[test]
    fn an_obstacle_appears_only_where_the_robot_has_a_sensor_for_it() -> Result<(), String> {
        let appears = "[[plant]]\nkind = \"obstacle\"\nat_m = [0.5, 0.0]\nradius_m = RADIUS\n\
                       from_s = 2.0\nmillis = 500\n";
        let among = |radius: &str, obstacles: Option<&ObstacleSettings>| {
            let among = read(&appears.replace("RADIUS", radius))?.among(obstacles);
            among.map_err(|impossible| impossible.key)
        };
        let sensor = ObstacleSettings::default();
        let seen = among("0.2", Some(&sensor))?.map(|obstacles| obstacles.appearing);
        let one = Appearing { at_m: [0.5, 0.0], radius_m: 0.2, from_s: 2.0, until_s: 2.5 };
        assert_eq!(seen, Some(vec![one]));
        assert_eq!(among("0.2", None), Err("plant.0.kind".to_owned()));
        assert!(among("-1.0", Some(&sensor)).is_err());
        Ok(())
    }

    #[test]
    fn a_fault_of_the_robot_has_the_keys_of_its_kind_and_no_others() {
        for (keys, key) in [
            ("kind = \"weak-motor\"\nwheel = \"rear-left\"", "gain"),
            ("kind = \"weak-motor\"\nwheel = \"rear-left\"\ngain = 1.5", "gain"),
            ("kind = \"dead-motor\"\nwheel = \"rear-left\"\ngain = 0.5", "gain"),
            ("kind = \"dead-motor\"", "wheel"),
            ("kind = \"slip\"\ngrip = nan", "grip"),
            ("kind = \"payload\"\nmass_kg = -1.0", "mass_kg"),
            ("kind = \"stuck-sensor\"", "sensor"),
            ("kind = \"stuck-sensor\"\nsensor = \"pose\"\nmillis = 0", "millis"),
            ("kind = \"stuck-sensor\"\nsensor = \"pose\"\ngrip = 0.5", "grip"),
            ("kind = \"emergency-stop\"\ngrip = 0.5", "grip"),
            ("kind = \"obstacle\"\nradius_m = 0.2", "at_m"),
            ("kind = \"obstacle\"\nat_m = [0.0, 0.0]", "radius_m"),
        ] {
            let refused =
                read(&format!("[[plant]]\nfrom_s = 1.0\n{keys}\n")).err().unwrap_or_default();
            assert!(refused.contains(&format!("plant.0.{key}")), "{keys}: {refused}");
        }
        let refused = read("[[plant]]\nfrom_s = -1.0\nkind = \"slip\"\ngrip = 0.5\n")
            .err()
            .unwrap_or_default();
        assert!(refused.contains("plant.0.from_s"), "{refused}");
    }
}
