//! The page: what a snapshot has learned, as slices with bands.

use crate::show::UNITS;
use crate::slices::{Slice, Slices};
use identify::log::AXIS_NAMES;
use recorder::report::axis::{Axis, Extent};
use recorder::report::page::head;
use recorder::report::panel::{Detail, HEIGHT, Panel, escape};
use std::fmt::Write;

/// What the page shows.
#[derive(Debug)]
pub struct Page<'a> {
    /// Name of the snapshot.
    pub name: &'a str,
    /// Its table, line by line.
    pub facts: &'a [String],
    /// Its slices.
    pub slices: &'a Slices,
}

impl Page<'_> {
    /// The page, one self-contained HTML file.
    pub fn html(&self) -> String {
        let heading = format!("Model: {}", escape(self.name));
        let mut html = head(&heading, &heading);
        for fact in self.facts {
            let _ = write!(html, "<p class=\"facts\">{}</p>", escape(fact));
        }
        html.push_str("</header>");
        for (axis, name) in AXIS_NAMES.iter().enumerate() {
            let _ = write!(
                html,
                "<figure id=\"{name}\"><h2>Residual {name}</h2><figcaption>Per period, over one \
                 input; the others are at the mean of the data. The band is two standard \
                 deviations of the function. Dots are the data points, whose other inputs \
                 differ.</figcaption>\
                 <div class=\"panels\">"
            );
            self.slices
                .all
                .iter()
                .filter(|slice| slice.axis == axis)
                .for_each(|slice| html.push_str(&panel(slice)));
            html.push_str("</div></figure>");
        }
        let version = env!("CARGO_PKG_VERSION");
        let _ = writeln!(html, "<footer>coxswain {version}</footer></main></body></html>");
        html
    }
}

/// One slice.
fn panel(slice: &Slice) -> String {
    let across = Extent::of(slice.mean.iter().map(|point| point.0));
    let mut up = Extent::of(slice.band.iter().flat_map(|&(_, low, high)| [low, high]));
    up.include(slice.data.iter().map(|point| point.1));
    let title = format!("{} [{}]", AXIS_NAMES[slice.axis], UNITS[slice.axis]);
    let axes = (Axis::linear(across), Axis::linear(up.padded()));
    let mut panel = Panel::new(title.as_str(), axes.0, axes.1, Detail::for_records(1))
        .shaped(slice.input, HEIGHT);
    panel.area("r0", &slice.band);
    panel.level(0.0, "");
    panel.dots("r1", slice.data.iter().copied());
    panel.line("r0", f64::INFINITY, slice.mean.iter().copied());
    panel.finish(&format!("residual {title} over {}", slice.input))
}
