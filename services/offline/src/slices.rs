//! Slices through a learned model: the residual of each axis over one input, the others at the mean
//! of the data.

use controller::adopt::Candidate;
use model::AXES;
use model::learned::{INPUTS, INPUTS_WITH_PLACE, Layout, Moment};
use protocol::message::ModelSnapshot;
use recorder::report::axis::Extent;

/// Points of a curve.
const POINTS: usize = 81;

/// Half width of the band in standard deviations.
const HALF_WIDTH: f64 = 2.0;

type Inputs = [f64; INPUTS_WITH_PLACE];

/// One curve with its band, and the data.
#[derive(Debug, Clone)]
pub struct Slice {
    /// What varies, with its unit.
    pub input: &'static str,
    /// Axis of the residual.
    pub axis: usize,
    /// Mean over the input.
    pub mean: Vec<(f64, f64)>,
    /// The band: input, lower and upper edge.
    pub band: Vec<(f64, f64, f64)>,
    /// Data points, projected on the input.
    pub data: Vec<(f64, f64)>,
}

/// All slices through one model.
#[derive(Debug, Clone)]
pub struct Slices {
    /// One for each input and axis, axis by axis.
    pub all: Vec<Slice>,
}

/// What varies, in the order of the inputs.
fn names(layout: Layout) -> &'static [&'static str] {
    const VELOCITY_INPUT: [&str; 6] = [
        "velocity forward [m/s]",
        "velocity left [m/s]",
        "yaw rate [rad/s]",
        "input forward [m/s]",
        "input left [m/s]",
        "input yaw [rad/s]",
    ];
    const SLIP: [&str; 9] = [
        "velocity forward [m/s]",
        "velocity left [m/s]",
        "yaw rate [rad/s]",
        "input − velocity forward [m/s]",
        "input − velocity left [m/s]",
        "input − velocity yaw [rad/s]",
        "input before − velocity forward [m/s]",
        "input before − velocity left [m/s]",
        "input before − velocity yaw [rad/s]",
    ];
    const HEADING: [&str; 7] =
        [SLIP[0], SLIP[1], SLIP[2], SLIP[3], SLIP[4], SLIP[5], "heading [rad]"];
    const PLACE: [&str; 9] =
        [SLIP[0], SLIP[1], SLIP[2], SLIP[3], SLIP[4], SLIP[5], "x [m]", "y [m]", HEADING[INPUTS]];
    match layout {
        Layout::VelocityInput => &VELOCITY_INPUT,
        Layout::VelocitySlip => SLIP.split_at(INPUTS).0,
        Layout::VelocitySlipHistory => &SLIP,
        Layout::VelocitySlipHeading => &HEADING,
        Layout::VelocitySlipPlace => &PLACE,
    }
}

/// Index of what varies that is the heading, an angle.
fn heading_index(layout: Layout) -> Option<usize> {
    match layout {
        Layout::VelocitySlipHeading => Some(INPUTS),
        Layout::VelocitySlipPlace => Some(INPUTS + 2),
        _ => None,
    }
}

/// Value of the input `index`; the heading is an angle.
fn value(layout: Layout, inputs: &Inputs, index: usize) -> f64 {
    if heading_index(layout) == Some(index) { layout.moment(inputs).heading } else { inputs[index] }
}

/// The period with `inputs`, but with another value of the input `index`.
fn with_value(layout: Layout, inputs: &Inputs, index: usize, value: f64) -> Moment {
    if heading_index(layout) == Some(index) {
        return Moment { heading: value, ..layout.moment(inputs) };
    }
    let mut inputs = *inputs;
    inputs[index] = value;
    layout.moment(&inputs)
}

impl Slices {
    /// The slices through `model`, which is that of `snapshot`.
    pub fn new(snapshot: &ModelSnapshot, layout: Layout, model: &mut Candidate) -> Self {
        let data = data(snapshot);
        let mut mean: Inputs = [0.0; INPUTS_WITH_PLACE];
        for (inputs, _) in &data {
            for (mean, input) in mean.iter_mut().zip(inputs) {
                *mean += input / data.len() as f64;
            }
        }
        let slices = (0..AXES).flat_map(|axis| {
            names(layout).iter().enumerate().map(move |(index, name)| (axis, index, *name))
        });
        let all = slices
            .map(|(axis, index, input)| {
                let mut points: Vec<(f64, f64)> = data
                    .iter()
                    .map(|(inputs, target)| (value(layout, inputs, index), target[axis]))
                    .collect();
                points.sort_by(|a, b| a.0.total_cmp(&b.0));
                let Extent { low, high } = Extent::of(points.iter().map(|point| point.0)).padded();
                let mut slice = Slice { input, axis, mean: vec![], band: vec![], data: points };
                for step in 0..POINTS {
                    let x = low + (high - low) * step as f64 / (POINTS - 1) as f64;
                    let at = with_value(layout, &mean, index, x);
                    let y = model.learned.mean(&at)[axis];
                    let variance = model.learned.variance(&at, &mut model.scratch)[axis];
                    let half = HALF_WIDTH * variance.sqrt();
                    slice.mean.push((x, y));
                    slice.band.push((x, y - half, y + half));
                }
                slice
            })
            .collect();
        Self { all }
    }
}

/// The data points: inputs, not normalised, and residuals.
fn data(snapshot: &ModelSnapshot) -> Vec<(Inputs, [f64; AXES])> {
    let head = &snapshot.head;
    snapshot
        .rows()
        .map(|row| {
            let mut inputs: Inputs = [0.0; INPUTS_WITH_PLACE];
            let scales = head.input_mean.iter().zip(&head.input_scale);
            for ((input, normalised), (mean, scale)) in inputs.iter_mut().zip(row.input).zip(scales)
            {
                *input = mean + scale * normalised;
            }
            let mut target = [0.0; AXES];
            target.iter_mut().zip(row.target).for_each(|(target, value)| *target = *value);
            (inputs, target)
        })
        .collect()
}
