//! Loops compiled a second time, for the wider vector registers of the machine they happen to run on.
//!
//! A binary is built for the smallest machine; here it looks at the one it runs on. The loops take no fused multiplications and
//! have their sums in a fixed order, so both versions give the same bits.

use faer::traits::pulp::{Arch, Simd, WithSimd};

/// Runs `task` with the vector instructions of `machine`.
///
/// Only what is inlined into `task` has them: mark it, and what it calls, `#[inline(always)]`.
#[inline]
pub(crate) fn vectorise<R>(machine: Arch, task: impl FnMut() -> R) -> R {
    machine.dispatch(Task(task))
}

/// A closure called as `FnMut`: the shim that calls it as `FnOnce`, which pulp would do, is not inlined.
struct Task<F>(F);

impl<R, F: FnMut() -> R> WithSimd for Task<F> {
    type Output = R;

    #[expect(
        clippy::inline_always,
        reason = "must be inlined to take on the vector features of its caller"
    )]
    #[inline(always)]
    fn with_simd<S: Simd>(mut self, _: S) -> R {
        (self.0)()
    }
}
