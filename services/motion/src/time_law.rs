//! Place along a curve at each time: s, ṡ and s̈.
//!
//! Between two grid points s̈ is constant, and it jumps there. The mean of s over the last T
//! seconds has no jump in s̈: where s̈ jumps by Δ, that of the mean takes T seconds for it. Its
//! third derivative is at most Δ/T.

/// The begin of a motion: s, ṡ and s̈ at the time 0, and before it with the same s̈.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Start {
    at: f64,
    speed: f64,
    rate: f64,
    /// T \[s\].
    window_s: f64,
}

impl Start {
    /// The start of which the mean over `window_s` begins at 0, with ṡ = `speed` and s̈ = `rate`.
    /// None if it would go backwards.
    pub(crate) fn averaged(speed: f64, rate: f64, window_s: f64) -> Option<Self> {
        let speed = speed + 0.5 * window_s * rate;
        let at = window_s * (0.5 * speed - window_s * rate / 6.0);
        (speed >= 0.0 && at >= 0.0).then_some(Self { at, speed, rate, window_s })
    }

    pub(crate) fn at(&self) -> f64 {
        self.at
    }

    pub(crate) fn window_s(&self) -> f64 {
        self.window_s
    }

    /// ṡ² at `place`.
    pub(crate) fn square_at(&self, place: f64) -> f64 {
        self.speed * self.speed + 2.0 * self.rate * (place - self.at)
    }
}

/// s, ṡ, s̈, and the integral of s since the time 0.
type Raw = [f64; 4];

/// `raw`, `time` later with the same s̈.
fn later([s, speed, rate, integral]: Raw, time: f64) -> Raw {
    [
        s + time * (speed + 0.5 * rate * time),
        speed + rate * time,
        rate,
        integral + time * (s + time * (0.5 * speed + time * rate / 6.0)),
    ]
}

/// Place along a curve at each time.
#[derive(Debug, Clone)]
pub(crate) struct TimeLaw {
    start: Start,
    /// Time at each grid point \[s\].
    times: Vec<f64>,
    /// From each grid point on.
    raw: Vec<Raw>,
}

impl TimeLaw {
    /// From `start` on, with ṡ² = `speeds` at the grid points every `step` from the one with the
    /// number `first` on.
    pub(crate) fn new(start: Start, step: f64, first: usize, speeds: &[f64]) -> Self {
        let begin = [start.at, start.speed, start.rate, 0.0];
        let to_grid = step * first as f64 - start.at;
        let mut time = match speeds.first() {
            Some(x) if to_grid > 0.0 => 2.0 * to_grid / (start.speed + x.sqrt()),
            _ => 0.0,
        };
        let mut integral = later(begin, time)[3];
        let (mut times, mut raw) = (Vec::new(), Vec::new());
        for (index, x) in speeds.iter().enumerate() {
            let next = speeds.get(index + 1).unwrap_or(x);
            let here =
                [step * (first + index) as f64, x.sqrt(), (next - x) / (2.0 * step), integral];
            times.push(time);
            raw.push(here);
            let taken = 2.0 * step / (x.sqrt() + next.sqrt());
            integral = later(here, taken)[3];
            time += taken;
        }
        Self { start, times, raw }
    }

    pub(crate) fn duration_s(&self) -> f64 {
        self.times.last().copied().unwrap_or(0.0) + self.start.window_s
    }

    fn raw(&self, time: f64) -> Raw {
        let next = self.times.partition_point(|&at| at <= time);
        let passed = self.times.iter().zip(&self.raw).take(next).next_back();
        let Some((at, raw)) = passed else {
            return later([self.start.at, self.start.speed, self.start.rate, 0.0], time);
        };
        let [s, speed, rate, integral] = later(*raw, time - at);
        [s, speed.max(0.0), rate, integral]
    }

    /// s, ṡ and s̈ at `time`.
    pub(crate) fn at(&self, time: f64) -> [f64; 3] {
        let window_s = self.start.window_s;
        let (now, before) = (self.raw(time), self.raw(time - window_s));
        let change = |of: usize| (now[of] - before[of]) / window_s;
        [change(3), change(0), change(1)]
    }
}
