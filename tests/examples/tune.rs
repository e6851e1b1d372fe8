use controller::settings::LearnedSettings;
use process::{Pace, Run, Stop};
use protocol::message::*;
use protocol::port::*;
use std::thread;
use std::time::Duration;

#[derive(serde::Deserialize)]
struct Scenario { period_millis: u64, duration_s: f64, seed: u64, start: plant_sim::truth::Start, reference: controller::reference::ReferenceSettings, mpc: controller::settings::MpcSettings, learner: learner::settings::LearnerSettings, truth: plant_sim::truth::Truth }

fn main() {
    let args: Vec<String> = std::env::args().collect();
    let on = args[2] == "on";
    let robot: model::robot::Robot = toml::from_str(&std::fs::read_to_string("deploy/robots/mecanum.toml").unwrap()).unwrap();
    let text = std::fs::read_to_string(&args[1]).unwrap();
    let mut table: toml::Table = text.parse().unwrap();
    for over in &args[3..] {
        let (k, v) = over.split_once('=').unwrap();
        let mut t = &mut table;
        let parts: Vec<&str> = k.split('.').collect();
        for p in &parts[..parts.len() - 1] { t = t.get_mut(*p).unwrap().as_table_mut().unwrap(); }
        let val: toml::Table = format!("x = {v}").parse().unwrap();
        t.insert(parts[parts.len() - 1].to_string(), val["x"].clone());
    }
    let s: Scenario = table.try_into().unwrap();
    let dir = tempfile::tempdir().unwrap();
    let run = Run { links: Links { graph: "x".into(), lock_step: true, root: dir.path().into(), patience_millis: 5000, carrier: Carrier::SharedMemory }, folder: dir.path().into(), log: "warn".into(), epoch_floor: 0, restarted: false, period_nanos: s.period_millis * 1_000_000, pace: Pace::LockStep };
    let ex = Exchange::new(true, Duration::from_secs(5));
    let stop = Stop::new();
    let cs = controller::Settings { run: run.clone(), duration_s: s.duration_s, start: s.start.pose, robot, reference: s.reference.clone(), mpc: s.mpc, learned: LearnedSettings { enabled: on, layout: s.learner.layout, every_ticks: s.learner.every_ticks, delay_ticks: s.learner.delay_ticks } };
    let ls = learner::Settings { run: run.clone(), robot, learner: s.learner.clone() };
    let ps = plant_sim::Settings { run: run.clone(), duration_s: s.duration_s, seed: s.seed, link_delay_millis: 0, recorded: false, start: s.start, robot, truth: s.truth.clone() };
    let rp = Ports::in_memory(&ex, Identity::new(1));
    let mut truths: Source<Truth> = rp.source(Since::First).unwrap();
    let mut plans: Source<Plan> = rp.source(Since::First).unwrap();
    let mut snaps: Source<ModelSnapshot> = rp.source(Since::First).unwrap();
    let begin = std::time::Instant::now();
    let (mut t, mut p, mut sn) = (vec![], vec![], vec![]);
    thread::scope(|sc| {
        let (exc, exl, exp) = (ex.clone(), ex.clone(), ex.clone());
        let (st1, st2, st3) = (stop.clone(), stop.clone(), stop.clone());
        let c = sc.spawn(move || controller::run::run(&cs, |id| Ok(Ports::in_memory(&exc, id)), &st1).unwrap());
        if on { sc.spawn(move || { learner::run::run(&ls, &Ports::in_memory(&exl, Identity::new(1)), &st2).unwrap() }); }
        thread::sleep(Duration::from_millis(50));
        let h = sc.spawn(move || { let id = Identity::new(1); plant_sim::run::run(&ps, &Ports::in_memory(&exp, id), id, &st3).unwrap() });
        while !h.is_finished() {
            while let Some(m) = truths.next().unwrap() { t.push(m) }
            while let Some(m) = plans.next().unwrap() { p.push(m) }
            while let Some(m) = snaps.next().unwrap() { sn.push(m) }
            thread::sleep(Duration::from_micros(300));
        }
        stop.request();
        c.join().unwrap();
    });
    while let Some(m) = truths.next().unwrap() { t.push(m) }
    while let Some(m) = plans.next().unwrap() { p.push(m) }
    let took = begin.elapsed();
    let dt = run.period_nanos as f64 * 1e-9;
    let n = t.len().min(p.len());
    let err: Vec<f64> = (0..n).map(|i| (t[i].pose[0] - p[i].reference[0][0]).hypot(t[i].pose[1] - p[i].reference[0][1])).collect();
    let spd: Vec<f64> = (0..n).map(|i| (t[i].velocity[0].hypot(t[i].velocity[1]) - p[i].reference[0][3].hypot(p[i].reference[0][4])).abs()).collect();
    let settle = |v: &[f64], band: f64| (0..v.len()).rev().find(|&i| v[i] > band).map_or(0.0, |i| (i + 1) as f64 * dt);
    let from = (3.0 / dt) as usize;
    let rmse = (err[from..].iter().map(|e| e * e).sum::<f64>() / (n - from) as f64).sqrt();
    let last = n - (10.0 / dt) as usize;
    let mut ticks: Vec<u64> = p.iter().map(|p| p.tick_nanos).collect(); ticks.sort();
    let mean_last = err[last..].iter().sum::<f64>() / (n - last) as f64;
    println!("n {n} arrival {:.1} settle {:.1} steady {:.4} rmse {:.4} max {:.4} meanlast {:.4} tick p50 {} p99 {} us took {:.2}s snaps {} fresh {}", settle(&err, 0.1), settle(&spd, 0.07), spd[last..].iter().cloned().fold(0.0, f64::max), rmse, err[from..].iter().cloned().fold(0.0, f64::max), mean_last, ticks[n / 2] / 1000, ticks[n * 99 / 100] / 1000, took.as_secs_f64(), sn.len(), p.iter().filter(|p| p.rung() == Rung::FreshPlan).count());
    if std::env::var("V").is_ok() {
        for i in (0..n).step_by(if n > 300 { 10 } else { 1 }).take(60) { println!("{:5.1} err {:.3} v {:.2} {:.2} {:.2} u {:.2} {:.2} {:.2} innov {:+.4} {:+.4} {:+.4} d {:+.4} {:+.4} model {} it {} lin {}us qp {}us", i as f64 * dt, err[i], t[i].velocity[0], t[i].velocity[1], t[i].velocity[2], p[i].input[0][0], p[i].input[0][1], p[i].input[0][2], p[i].innovation[0], p[i].innovation[1], p[i].innovation[2], p[i].disturbance[0], p[i].disturbance[1], p[i].model_version, p[i].iterations, p[i].linearise_nanos / 1000, p[i].solve_nanos / 1000) }
        for s in &sn { println!("v{} n {} score {} learned {:.4?} main {:.4?} ll {:.1?} ell {:.1?}", s.head.version, s.head.points, s.head.score_samples, s.head.score_learned, s.head.score_main, s.head.log_likelihood, &s.head.length_scale[0][..6]); }
    }
}
