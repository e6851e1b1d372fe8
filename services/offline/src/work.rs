//! Settings and periods → snapshot: trained, judged against simpler models, and refused if it is no
//! better.

use crate::command::LearnError;
use crate::cross_validation::{Errors, FOLDS, Findings, MARGIN_S, NAMES, STEPS, cross_validate};
use crate::periods::Passage;
use crate::prior::{NOISES, carried};
use crate::training::Training;
use crate::verdict::Verdict;
use learner::data_set::{fingerprint_of, main_model};
use learner::snapshot::{self, Label};
use model::main_model::MainModel;
use protocol::VERSION;
use protocol::message::{Message, ModelSnapshot};

/// Samples per point of a snapshot above which earlier data would only displace newer data.
const SAMPLES_PER_POINT: usize = 3;

/// Largest share of samples that the main model cannot explain with any plausible residual.
const IMPLAUSIBLE_MAX: f64 = 0.2;

/// What a snapshot is made from.
#[derive(Debug)]
pub struct Work<'a> {
    /// Settings of the learner.
    pub learner: &'a learner::Settings,
    /// Settings of the controller.
    pub controller: &'a controller::Settings,
    /// The logs.
    pub passages: &'a [Passage],
    /// A snapshot to carry over, and the main model that it was learned with.
    pub earlier: Option<&'a (ModelSnapshot, MainModel)>,
}

impl Work<'_> {
    /// The snapshot of a model over D inputs that is better than none. Prints the comparison.
    ///
    /// # Errors
    /// [`LearnError`] if the logs are those of another robot, or if the model is no better.
    pub fn snapshot<const D: usize>(&self) -> Result<ModelSnapshot, LearnError> {
        let training = Training::<D>::new(self.learner);
        self.check_robot(&training)?;
        let (training, findings) = self.carry_over(training)?;
        let verdict = Verdict::of(&findings);
        print(&findings, &verdict);
        if !verdict.is_better() {
            return Err(LearnError::NoBetter(verdict));
        }
        let mut fitted = training.fit(self.passages.iter().flatten())?;
        let of_likelihood = fitted.learned.sample_variance;
        fitted.learned.sample_variance =
            findings.held_out.noise(&of_likelihood, &training.fit.noise_floor());
        let label = Label {
            version: 1,
            fingerprint: fingerprint_of(self.learner),
            plant_epoch: 0,
            trained_tick: 0,
            effective_tick: 0,
        };
        let mut snapshot = snapshot::write(&fitted, &label, &[])?;
        let [[main, _], .., [learned, _], _] = findings.errors;
        let head = &mut snapshot.head;
        // No sink stamps it.
        (head.stamp.version, head.stamp.kind) = (VERSION, ModelSnapshot::KIND);
        (head.score_main, head.score_learned) = (main, learned);
        head.score_samples = u32::try_from(findings.periods).unwrap_or(u32::MAX);
        Ok(snapshot)
    }

    /// The training with the data of the earlier snapshot, if there is one and it helps on held-out
    /// motion.
    ///
    /// # Errors
    /// [`LearnError::Fit`].
    pub fn carry_over<'t, const D: usize>(
        &'t self,
        mut training: Training<'t, D>,
    ) -> Result<(Training<'t, D>, Findings), LearnError> {
        let mut findings = cross_validate(self.passages, self.controller, &training)?;
        let Some((snapshot, from)) = self.earlier else { return Ok((training, findings)) };
        let (layout, to) = (self.learner.learner.layout, main_model(self.learner));
        let samples: usize = self.passages.iter().map(Vec::len).sum();
        if samples > SAMPLES_PER_POINT * self.learner.learner.points_max {
            terminal::print("the logs alone fill the snapshot: the earlier data are not used");
            return Ok((training, findings));
        }
        for noise in NOISES {
            let prior = carried(snapshot, layout, [from, &to], &training.fit.bound, noise);
            let other = Training::new(self.learner).with_prior(prior);
            let found = cross_validate(self.passages, self.controller, &other)?;
            let [.., with] = &found.errors;
            let [.., without] = &findings.errors;
            let verdict = Verdict::between(with, without);
            let [one, ten] = verdict.means();
            let helps = verdict.is_better();
            terminal::print(format_args!(
                "the earlier data with {noise} times its noise: errors {one:.3} (1 step) and \
                 {ten:.3} ({STEPS} steps) times as large, {}",
                if helps { "used" } else { "not used" }
            ));
            if helps {
                (training, findings) = (other, found);
            }
        }
        Ok((training, findings))
    }

    /// Fails if many residuals are larger than is plausible for this robot.
    fn check_robot<const D: usize>(&self, training: &Training<'_, D>) -> Result<(), LearnError> {
        let bound = training.fit.bound;
        let residuals = || self.passages.iter().flatten().map(|period| period.sample.residual);
        let is_beyond = |residual: &[f64; 3]| (0..3).any(|axis| residual[axis].abs() > bound[axis]);
        let share = residuals().filter(is_beyond).count() as f64 / residuals().count() as f64;
        if share > IMPLAUSIBLE_MAX { Err(LearnError::OtherRobot { share }) } else { Ok(()) }
    }
}

fn print(findings: &Findings, verdict: &Verdict) {
    terminal::print(format_args!(
        "{FOLDS} trainings; blocks of {:.1} s, each held out once, without {MARGIN_S} s beside \
             it\n{:26}{:>27}{:>30}\n{:26}{:>9}{:>9}{:>9}{:>12}{:>9}{:>9}",
        findings.block_s,
        "RMS [m/s, m/s, rad/s]",
        "1 step",
        format!("{STEPS} steps"),
        "",
        "forward",
        "left",
        "yaw",
        "forward",
        "left",
        "yaw"
    ));
    for (name, errors) in NAMES.into_iter().zip(&findings.errors) {
        print_row(name, errors, 5);
    }
    print_row("ratio, last to second", &verdict.ratios, 3);
}

fn print_row(name: &str, [one, ten]: &Errors, digits: usize) {
    terminal::print(format_args!(
        "{name:26}{:9.digits$}{:9.digits$}{:9.digits$}{:12.digits$}{:9.digits$}{:9.digits$}",
        one[0], one[1], one[2], ten[0], ten[1], ten[2]
    ));
}
