//! The page: parameters, what the data do not tell, and measured beside simulated motion.

use crate::log::{AXIS_NAMES, Log};
use crate::numbers::{Known, Number};
use crate::response::{Response, Simulation};
use crate::tuned::Recommendation;
use recorder::report::axis::{Axis, Extent};
use recorder::report::page::head;
use recorder::report::panel::{Detail, Panel, escape};
use robot::{AXES, Velocity};
use std::fmt::Write;

/// Units of the velocity axes.
const UNITS: [&str; AXES] = ["m/s", "m/s", "rad/s"];

/// What the page shows.
#[derive(Debug)]
pub struct Page<'a> {
    /// Names of the logs.
    pub source: &'a str,
    /// All data.
    pub log: &'a Log,
    /// Share of each stretch from which on `checked` was not estimated from it.
    pub held_out_from: f64,
    /// All numbers, from all data.
    pub known: &'a Known<'a>,
    /// The response that was estimated without the part held out.
    pub checked: &'a Response,
    /// Prediction errors on the part held out: one step and ten steps ahead, of `checked` and of
    /// the robot file that was given.
    pub errors: &'a [(&'static str, [Velocity; 2])],
    /// What the data do not tell.
    pub untold: &'a [String],
    /// Period and horizon.
    pub recommended: &'a Recommendation,
}

impl Page<'_> {
    /// The page, one self-contained HTML file.
    pub fn html(&self) -> String {
        let heading = format!("Identified: {}", escape(self.source));
        let mut html = head(&heading, &heading);
        let _ = write!(
            html,
            "<p class=\"facts\">{:.1} s at {:.1} ms, {} stretches without a gap</p>",
            self.log.duration_s(),
            1e3 * self.log.period_s,
            self.log.stretches.len()
        );
        for note in &self.log.notes {
            let _ = write!(html, "<p class=\"note\">{}</p>", escape(note));
        }
        html.push_str("</header>");
        write_numbers(&mut html, ("parameters", "Response"), &self.known.response());
        self.write_untold(&mut html);
        let others = ("others", "Limits, wheels and sensors");
        write_numbers(&mut html, others, &self.known.others());
        self.write_errors(&mut html);
        self.write_motion(&mut html);
        let version = env!("CARGO_PKG_VERSION");
        let _ = writeln!(html, "<footer>coxswain {version}</footer></main></body></html>");
        html
    }

    fn write_untold(&self, html: &mut String) {
        let Recommendation { period_millis, horizon_steps, profile, .. } = self.recommended;
        let _ = write!(
            html,
            "<section id=\"use\"><h2>Use</h2><p>Period {period_millis} ms, horizon {horizon_steps} \
             periods, weights of the profile {profile}.</p>"
        );
        if !self.untold.is_empty() {
            html.push_str("<h2>What the data do not tell</h2><ul>");
            for line in self.untold {
                let _ = write!(html, "<li>{}</li>", escape(line));
            }
            html.push_str("</ul>");
        }
        html.push_str("</section>");
    }

    fn write_errors(&self, html: &mut String) {
        html.push_str(
            "<section id=\"errors\"><h2>Prediction of motion that was held out</h2>\
             <p class=\"facts\">RMS of the velocity's error, estimated without this motion.</p>\
             <div class=\"scroll\"><table><thead><tr><th>response</th><th>steps</th>\
             <th>forward [m/s]</th><th>left [m/s]</th><th>yaw [rad/s]</th></tr></thead><tbody>",
        );
        for (name, errors) in self.errors {
            for (steps, error) in [1, 10].into_iter().zip(errors) {
                let [a, b, c] = error.map(|it| format!("{it:.4}"));
                let _ = write!(
                    html,
                    "<tr><th>{}</th><td>{steps}</td><td>{a}</td><td>{b}</td><td>{c}</td></tr>",
                    escape(name)
                );
            }
        }
        html.push_str("</tbody></table></div></section>");
    }

    /// Measured and simulated velocity at the held-out end of the longest stretch, and their
    /// difference.
    fn write_motion(&self, html: &mut String) {
        let longest = self.log.stretches.iter().max_by_key(|stretch| stretch.len());
        let Some(stretch) = longest.filter(|stretch| stretch.len() > 1) else { return };
        let simulation = Simulation::new(self.known.wheels, stretch, self.log.period_s);
        let from = (self.held_out_from * stretch.len() as f64) as usize;
        let run = simulation.whole(self.checked);
        let shown = || stretch.iter().skip(1).zip(&run).skip(from);
        let times: Vec<f64> = shown().map(|(sample, _)| sample.time_s).collect();
        let across = Axis::linear(Extent::of(times.iter().copied()));
        html.push_str(
            "<figure id=\"motion\"><h2>Measured and simulated</h2><figcaption>The held-out \
             end of the longest stretch, simulated from the begin of the stretch on.</figcaption>\
             <ul class=\"legend\">\
             <li class=\"r0\"><span class=\"key\"></span>measured</li>\
             <li class=\"r1\"><span class=\"key\"></span>simulated</li></ul>\
             <div class=\"panels pairs\">",
        );
        for axis in (0..AXES).filter(|&axis| self.known.estimate.axes[axis]) {
            let measured: Vec<f64> = shown().map(|(sample, _)| sample.velocity[axis]).collect();
            let simulated: Vec<f64> = shown().map(|(_, motion)| motion.velocity[axis]).collect();
            let points = |values: &[f64]| -> Vec<(f64, f64)> {
                times.iter().copied().zip(values.iter().copied()).collect()
            };
            let gap = 2.5 * self.log.period_s;
            let detail = Detail::for_records(1);
            let both = Extent::of(measured.iter().chain(&simulated).copied()).padded();
            let name = AXIS_NAMES[axis];
            let title = format!("velocity {name} [{}]", UNITS[axis]);
            let mut panel = Panel::new(title.as_str(), across, Axis::linear(both), detail);
            panel.line("r0", gap, points(&measured));
            panel.line("r1", gap, points(&simulated));
            html.push_str(&panel.finish(&title));
            let errors: Vec<f64> = measured.iter().zip(&simulated).map(|(m, s)| m - s).collect();
            let extent = Extent::of(errors.iter().copied()).padded();
            let title = format!("measured − simulated, {name} [{}]", UNITS[axis]);
            let mut panel = Panel::new(title.as_str(), across, Axis::linear(extent), detail);
            panel.line("r2 thin", gap, points(&errors));
            panel.level(0.0, "");
            html.push_str(&panel.finish(&title));
        }
        html.push_str("</div></figure>");
    }
}

/// A table of numbers with their intervals.
fn write_numbers(html: &mut String, (id, heading): (&str, &str), numbers: &[Number]) {
    let _ = write!(
        html,
        "<section id=\"{id}\"><h2>{heading}</h2><div class=\"scroll\"><table><thead><tr>\
         <th>number</th><th>value</th><th>95 % interval</th><th>unit</th></tr></thead><tbody>"
    );
    for Number { name, measured, unit } in numbers {
        let _ = write!(
            html,
            "<tr><th>{}</th><td>{:.4}</td><td>± {:.4}</td><td>{unit}</td></tr>",
            escape(name),
            measured.value,
            measured.half_width
        );
    }
    html.push_str("</tbody></table></div></section>");
}
