//! Promise: of a simulated robot, whose parameters are known, the estimate finds them.

use identify::excitation::{Room, motion};
use identify::fit::{Estimate, beside, estimate};
use identify::judgement::{prediction_error, untold};
use identify::log::{Log, Sample};
use identify::numbers::Known;
use identify::parameter::Parameter;
use identify::reached::reached;
use identify::response::{Response, Simulation};
use identify::sensors::{Measured, sensors};
use nalgebra::{Matrix3, SMatrix};
use plant_sim::truth::{RandomForce, Sensor, Truth, World};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use robot::Wheels;
use std::error::Error;

type Outcome = Result<(), Box<dyn Error>>;

const ROOM: Room =
    Room { size_m: [3.0, 3.0], speed_mps: 1.0, yaw_rate_radps: 1.5, acceleration: [1e3; 3] };

/// Standard gravity \[m/s²\].
const GRAVITY: f64 = 9.806_65;

/// The robot of the paper with another mass, friction, motor and delay.
fn random_robot(seed: u64) -> Truth {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let mass = 22.0 * 2.0_f64.powf(random.random_range(-1.0..1.0));
    let mut motor_gain = vec![1.0; 4];
    motor_gain[random.random_range(0..4)] = random.random_range(0.6..1.0);
    Truth {
        mass_kg: mass,
        yaw_inertia_kg_m2: 0.04 * mass,
        wheel_viscous_friction_nms: random.random_range(1e-3..6e-3),
        rolling_friction: random.random_range(0.01..0.06),
        drag_n_s2_per_m2: 0.5,
        motor_gain,
        command_delay_s: (random.random_range(0.0..0.15_f64) * 1e4).round() * 1e-4,
        random_force: Some(RandomForce { bound_n: 3.0, bound_nm: 0.3, correlation_s: 0.2 }),
        sensor: Sensor {
            velocity_noise_mps: 0.005,
            yaw_rate_noise_radps: 0.005,
            position_noise_m: 0.002,
            heading_noise_rad: 0.002,
            ..Sensor::default()
        },
        ..Truth::default()
    }
}

/// 60 s of it, with the excitation as input.
fn drive(truth: &Truth, period_s: f64, seed: u64) -> Log {
    drive_in(&ROOM, truth, period_s, seed)
}

fn drive_in(room: &Room, truth: &Truth, period_s: f64, seed: u64) -> Log {
    let points = motion(room, 60.0, period_s, seed);
    let mut world = World::new(truth, driver::Start::default(), seed);
    let sample = |world: &mut World, time_s: f64, input: [f64; 3]| {
        let measured = world.measure();
        Sample {
            time_s,
            pose: measured.pose,
            velocity: measured.velocity,
            input,
            wheel_speed: Some(measured.wheel_speed),
        }
    };
    let mut stretch = vec![sample(&mut world, 0.0, [0.0; 3])];
    for pair in points.windows(2) {
        let [from, to] = [pair[0].pose, pair[1].pose];
        let (sin, cos) = (0.5 * (from[2] + to[2])).sin_cos();
        let [x, y, yaw] = [0, 1, 2].map(|axis| (to[axis] - from[axis]) / period_s);
        let input = [cos * x + sin * y, cos * y - sin * x, yaw];
        world.advance((period_s * 1e9).round() as u64, input);
        stretch.push(sample(&mut world, pair[1].time_s, input));
    }
    Log { period_s, stretches: vec![stretch], wheels: 4, ..Log::default() }
}

/// M v̇ = G (u − v) − F v − friction − drag + turning frame, as in `plant-sim`, in the form of a
/// response.
fn true_response(truth: &Truth) -> Response {
    let radius = truth.wheels.radius_m();
    let rows = truth.wheels.rows();
    let j = SMatrix::<f64, 4, 3>::from_fn(|wheel, axis| rows[wheel][axis] / radius);
    let stiffness =
        truth.pole_pairs * truth.torque_constant_nm_per_a * truth.speed_loop_gain_a_s_per_rad;
    let motors = SMatrix::<f64, 4, 4>::from_fn(|row, column| {
        let gain = truth.motor_gain.get(row).copied().unwrap_or(1.0);
        if row == column { stiffness * gain } else { 0.0 }
    });
    let [planar, yaw] = [truth.mass_kg, truth.yaw_inertia_kg_m2];
    let wheels = j.transpose() * j;
    let mass =
        Matrix3::from_diagonal(&[planar, planar, yaw].into()) + wheels * truth.wheel_inertia_kg_m2;
    let drive = j.transpose() * motors * j;
    let loss = drive + wheels * truth.wheel_viscous_friction_nms;
    let load = truth.rolling_friction * planar * GRAVITY / 4.0;
    let mut response = Response {
        friction_speed_mps: truth.rolling_friction_speed_scale_radps * radius,
        dead_time_s: [truth.command_delay_s; 3],
        turning: planar / mass[(0, 0)],
        drag_s_per_m: truth.drag_n_s2_per_m2 / loss[(0, 0)],
        saturation_mps: radius * truth.current_limit_a / truth.speed_loop_gain_a_s_per_rad,
        ..Response::default()
    };
    for axis in 0..3 {
        let own = loss[(axis, axis)];
        response.time_constant_s[axis] = mass[(axis, axis)] / own;
        response.friction[axis] = load * rows.iter().map(|row| row[axis].abs()).sum::<f64>() / own;
        for other in 0..3 {
            response.gain[axis][other] = drive[(axis, other)] / own;
            response.cross[axis][other] = loss[(axis, other)] / own;
        }
    }
    response
}

/// Input that overcomes the dry friction of each axis at any speed \[m/s, m/s, rad/s\].
fn most_friction(truth: &Truth) -> [f64; 3] {
    let of = |speed: f64| {
        let stuck =
            (truth.breakaway_factor - 1.0) * (-(speed / truth.breakaway_speed_radps).powi(2)).exp();
        (1.0 + stuck) * (speed / truth.rolling_friction_speed_scale_radps).tanh()
    };
    let most = (0..1000).map(|step| of(f64::from(step) * 0.01)).fold(0.0, f64::max);
    let response = true_response(truth);
    std::array::from_fn(|axis| response.friction[axis] * most / response.gain[axis][axis])
}

struct Judged {
    /// Largest relative error of gain and time constant, and largest error of the dead time \[s\].
    worst: [f64; 3],
    covered: u32,
    intervals: u32,
}

fn judge(truth: &Truth, estimate: &Estimate) -> Result<Judged, Box<dyn Error>> {
    let expected = true_response(truth);
    let mut judged = Judged { worst: [0.0; 3], covered: 0, intervals: 0 };
    for axis in 0..3 {
        let parameters =
            [Parameter::Gain(axis, axis), Parameter::TimeConstant(axis), Parameter::DeadTime(axis)];
        for (number, parameter) in parameters.into_iter().enumerate() {
            let expected = parameter.of(&expected);
            let found = estimate.of(parameter).ok_or("not estimated")?;
            let error = (found.value - expected).abs();
            let scale = if number == 2 { 1.0 } else { expected };
            judged.worst[number] = judged.worst[number].max(error / scale);
            judged.covered += u32::from(error <= found.half_width);
            judged.intervals += 1;
        }
    }
    Ok(judged)
}

/// The bars of one robot: gain within 3 %, time constant within 10 %, dead time within 5 ms.
fn is_close(judged: &Judged) -> bool {
    let [gain, constant, dead_time] = judged.worst;
    gain < 0.03 && constant < 0.1 && dead_time < 0.005
}

/// Largest ratio of the prediction errors 10 steps ahead on held-out motion, of an estimate and of
/// the true parameters: on the last quarter of `log`, estimated from the rest, and in another drive,
/// for which `estimate` has all of `log`.
fn ratios(truth: &Truth, log: &Log, estimate: &Estimate, seed: u64) -> [f64; 2] {
    let rest = log.first(0.75);
    let near = Some(&estimate.response);
    let of_rest = identify::fit::estimate(&rest, &truth.wheels, [true; 3], near, &mut |_| {});
    let other = drive(truth, log.period_s, seed + 100);
    [(log, of_rest.response, 0.75), (&other, estimate.response, 0.05)].map(|(log, found, from)| {
        let [found, exact] = [found, true_response(truth)]
            .map(|response| prediction_error(log, from, &truth.wheels, &response, 10));
        (0..3).map(|axis| found[axis] / exact[axis]).fold(0.0, f64::max)
    })
}

#[test]
fn gain_time_constant_and_dead_time_of_a_random_robot_are_found() -> Outcome {
    let truth = random_robot(5);
    let log = drive(&truth, 0.05, 5);
    let estimate = estimate(&log, &truth.wheels, [true; 3], None, &mut |_| {});
    let judged = judge(&truth, &estimate)?;
    assert!(is_close(&judged), "{:?}", judged.worst);
    assert!(judged.covered >= 6, "{} of {}", judged.covered, judged.intervals);
    let ratios = ratios(&truth, &log, &estimate, 5);
    assert!(ratios.iter().all(|ratio| *ratio < 1.3), "{ratios:?}");
    Ok(())
}

#[test]
fn friction_that_holds_the_robot_at_standstill_is_found_and_none_is_not_told() {
    for (breakaway_factor, seed) in [(2.5, 3), (2.0, 4), (1.0, 3)] {
        let truth = Truth { breakaway_factor, ..random_robot(seed) };
        let log = drive(&truth, 0.05, seed);
        let found = estimate(&log, &truth.wheels, [true; 3], None, &mut |_| {});
        let beside = beside(&log, &truth.wheels, &found.response);
        let reached = reached(log.period_s, &beside);
        let sensors = sensors(&log, &truth.wheels, &beside);
        let known =
            Known { estimate: &found, reached: &reached, sensors: &sensors, wheels: &truth.wheels };
        let expected = most_friction(&truth);
        for axis in 0..3 {
            let input = known.input_from_rest(axis);
            assert_eq!(input.is_some(), breakaway_factor > 1.0, "{input:?}");
            let Some(input) = input else { continue };
            let ratio = input.value / expected[axis];
            assert!((0.7..1.3).contains(&ratio), "axis {axis}: {ratio} {input:?}");
        }
    }
}

/// The robot of `deploy/worlds/robots/rosbot-xl.toml`, whose file is below the limit of its motors.
fn robot_with_integral_parts() -> Result<Truth, robot::ImpossibleWheels> {
    Ok(Truth {
        wheels: Wheels::mecanum(0.047, 0.17, 0.27)?,
        mass_kg: 7.5,
        yaw_inertia_kg_m2: 0.15,
        wheel_inertia_kg_m2: 6e-4,
        wheel_viscous_friction_nms: 1e-3,
        rolling_friction: 0.03,
        pole_pairs: 1.0,
        torque_constant_nm_per_a: 0.0216,
        speed_loop_gain_a_s_per_rad: 1.0,
        speed_loop_integral_a_per_rad: 3.0,
        current_limit_a: 12.0,
        command_delay_s: 0.04,
        ..random_robot(1)
    })
}

#[test]
fn the_saturation_of_speed_loops_with_integral_parts_is_found() -> Outcome {
    let truth = robot_with_integral_parts()?;
    let truth = Truth { motor_gain: vec![1.0; 4], random_force: None, ..truth };
    let room = Room { speed_mps: 0.5, acceleration: [2.0, 2.0, 8.0], ..ROOM };
    let log = drive_in(&room, &truth, 0.05, 4);
    let found = estimate(&log, &truth.wheels, [true; 3], None, &mut |_| {});
    let saturation = found.of(Parameter::Saturation).ok_or("not found")?;
    let expected = truth.wheels.radius_m() * truth.current_limit_a;
    assert!((saturation.value / expected - 1.0).abs() < 0.1, "{saturation:?} {expected}");
    for axis in 0..3 {
        // A loop with an integral part has no error in the end.
        let gain = found.of(Parameter::Gain(axis, axis)).ok_or("not estimated")?;
        assert!((gain.value - 1.0).abs() < 0.03, "axis {axis}: {gain:?}");
        // k_i/(k_p + f). In yaw it comes out 15 % too small.
        let integral = found.of(Parameter::Integral(axis)).ok_or("not found")?;
        let most = if axis < 2 { 0.1 } else { 0.2 };
        assert!((integral.value / 2.87 - 1.0).abs() < most, "axis {axis}: {integral:?}");
    }
    Ok(())
}

/// `truth` is within `found`, or within this multiple of its interval.
fn holds(found: Option<Measured>, truth: f64, multiple: f64) -> bool {
    found.is_some_and(|it| (it.value - truth).abs() <= multiple * it.half_width)
}

/// The velocity comes one period after the pose.
fn delay_velocity(log: &mut Log) {
    for stretch in &mut log.stretches {
        let velocities: Vec<_> = stretch.iter().map(|sample| sample.velocity).collect();
        for (sample, velocity) in stretch.iter_mut().skip(1).zip(velocities) {
            sample.velocity = velocity;
        }
    }
}

#[test]
fn noise_of_the_velocity_does_not_hide_its_latency() -> Outcome {
    const LATENCY_S: f64 = 0.02;
    for seed in 1..=4 {
        let mut truth = random_robot(seed);
        truth.sensor.velocity_noise_mps = 0.04;
        let mut log = drive(&truth, LATENCY_S, seed);
        delay_velocity(&mut log);
        let mut response = true_response(&truth);
        response.dead_time_s = response.dead_time_s.map(|it| it + LATENCY_S);
        let beside = beside(&log, &truth.wheels, &response);
        let latency = sensors(&log, &truth.wheels, &beside).latency_s.ok_or("no latency")?;
        assert!((latency.value - LATENCY_S).abs() < 0.005, "seed {seed}: {latency:?}");
        assert!(holds(Some(latency), LATENCY_S, 1.5), "seed {seed}: {latency:?}");
    }
    Ok(())
}

#[test]
fn radius_and_lever_of_the_wheels_latency_and_noise_are_found_and_few_intervals_miss() -> Outcome {
    // One period.
    const LATENCY_S: f64 = 0.02;
    let (mut missed, mut intervals) = (0, 0);
    for seed in 1..=6 {
        let wheels = Wheels::mecanum(0.0485, 0.25, 0.32)?;
        let truth = Truth { wheels, ..random_robot(seed) };
        let mut log = drive(&truth, LATENCY_S, seed);
        delay_velocity(&mut log);
        let stated = Truth::default().wheels;
        let mut response = true_response(&truth);
        response.dead_time_s = response.dead_time_s.map(|it| it + LATENCY_S);
        let sensors = sensors(&log, &stated, &beside(&log, &stated, &response));
        let radius = sensors.wheel_radius_m.ok_or("no radius")?;
        let lever = sensors.wheel_lever_m.ok_or("no lever")?;
        assert!((radius.value / 0.0485 - 1.0).abs() < 0.005, "{radius:?}");
        assert!((lever.value / 0.285 - 1.0).abs() < 0.01, "{lever:?}");
        assert!(
            sensors.latency_s.is_some_and(|it| (it.value - LATENCY_S).abs() < 0.005),
            "{sensors:?}"
        );
        let noises = sensors.velocity_noise.into_iter().zip([0.005; 3]);
        let noises = noises.chain(sensors.pose_noise.into_iter().zip([0.002; 3]));
        let noises = noises.map(|(found, truth)| (Some(found), truth));
        let others = [(Some(radius), 0.0485), (Some(lever), 0.285), (sensors.latency_s, LATENCY_S)];
        for (found, truth) in noises.chain(others) {
            assert!(holds(found, truth, 3.0), "{found:?} {truth}");
            missed += usize::from(!holds(found, truth, 1.0));
            intervals += 1;
        }
    }
    assert!(5 * missed <= intervals, "{missed} of {intervals}");
    Ok(())
}

#[test]
fn a_motor_that_couples_the_axes_is_told_and_a_healthy_robot_has_no_coupling() -> Outcome {
    for (weak, is_coupled) in [(0.6, true), (1.0, false)] {
        let truth = Truth { motor_gain: vec![1.0, weak, 1.0, 1.0], ..random_robot(7) };
        let log = drive(&truth, 0.05, 7);
        let found = estimate(&log, &truth.wheels, [true; 3], None, &mut |_| {});
        let beside = beside(&log, &truth.wheels, &found.response);
        let reached = reached(log.period_s, &beside);
        let sensors = sensors(&log, &truth.wheels, &beside);
        let known =
            Known { estimate: &found, reached: &reached, sensors: &sensors, wheels: &truth.wheels };
        let couplings = known.coupling();
        let of_yaw = found.of(Parameter::Gain(2, 0)).ok_or("not estimated")?;
        let expected = Parameter::Gain(2, 0).of(&true_response(&truth));
        assert!((of_yaw.value - expected).abs() < 2.0 * of_yaw.half_width, "{of_yaw:?} {expected}");
        assert_eq!(of_yaw.half_width < of_yaw.value.abs(), is_coupled, "{of_yaw:?}");
        let is_among = couplings.iter().any(|it| it.name == Parameter::Gain(2, 0).to_string());
        assert_eq!(is_among, is_coupled, "{couplings:?}");
    }
    Ok(())
}

#[test]
fn a_limit_of_the_acceleration_that_was_reached_is_found_and_another_is_not_told() -> Outcome {
    let wheels = Truth::default().wheels;
    let limited = Response {
        time_constant_s: [0.1, 0.15, 0.1],
        dead_time_s: [0.04; 3],
        acceleration: [2.0, f64::INFINITY, f64::INFINITY],
        ..Response::default()
    };
    let mut log = drive(&random_robot(1), 0.05, 2);
    let mut random = Pcg64Mcg::seed_from_u64(9);
    for stretch in &mut log.stretches {
        let run = Simulation::new(&wheels, stretch, log.period_s).whole(&limited);
        for (sample, motion) in stretch.iter_mut().skip(1).zip(run) {
            sample.velocity = motion.velocity.map(|it| it + random.random_range(-0.008..0.008));
        }
    }
    let found = estimate(&log, &wheels, [true; 3], None, &mut |_| {});
    let limit = found.of(Parameter::Acceleration(0)).ok_or("not found")?;
    assert!((limit.value / 2.0 - 1.0).abs() < 0.1, "{limit:?}");
    assert_eq!(found.of(Parameter::Acceleration(1)), None);
    let beside = beside(&log, &wheels, &found.response);
    let reached = reached(log.period_s, &beside);
    let sensors = sensors(&log, &wheels, &beside);
    let known = Known { estimate: &found, reached: &reached, sensors: &sensors, wheels: &wheels };
    assert!(untold(&known).iter().any(|line| line.contains("acceleration, left")));
    // The limit is what was reached.
    let most = reached.acceleration[0].ok_or("not reached")?;
    assert!((most.value - 2.0).abs() < most.half_width.max(0.1), "{most:?}");
    Ok(())
}

/// ```sh
/// cargo test --release -p identify --test simulated_robots -- --ignored --nocapture
/// ```
#[test]
#[ignore = "a campaign of minutes: docs/identification.md has its figures"]
#[expect(clippy::print_stdout, reason = "its table is read by people")]
fn twenty_random_robots() -> Outcome {
    for period_s in [0.02, 0.1] {
        let (mut covered, mut intervals, mut far) = (0, 0, 0);
        let mut worst = [0.0_f64; 5];
        for seed in 1..=20 {
            let truth = random_robot(seed);
            let log = drive(&truth, period_s, seed);
            let found = estimate(&log, &truth.wheels, [true; 3], None, &mut |_| {});
            let judged = judge(&truth, &found)?;
            let [gain, constant, dead_time] = judged.worst;
            let [last_quarter, other_drive] = ratios(&truth, &log, &found, seed);
            println!(
                "T {period_s} seed {seed}: gain {gain:.4}, time constant {constant:.4}, dead time \
                 {dead_time:.4} s, covered {}/{}, ratios of errors {last_quarter:.3} (last quarter), \
                 {other_drive:.3} (another drive)",
                judged.covered, judged.intervals
            );
            (covered, intervals) = (covered + judged.covered, intervals + judged.intervals);
            far += usize::from(!is_close(&judged));
            let all = [gain, constant, dead_time, last_quarter, other_drive];
            for (worst, value) in worst.iter_mut().zip(all) {
                *worst = worst.max(value);
            }
        }
        println!("T {period_s}: worst {worst:.4?}, covered {covered} of {intervals}");
        assert!(far == 0, "{far} far off");
        let share = f64::from(covered) / f64::from(intervals);
        assert!((0.9..=0.98).contains(&share), "{share}");
        assert!(worst[4] <= 1.3, "{worst:?}");
    }
    Ok(())
}
