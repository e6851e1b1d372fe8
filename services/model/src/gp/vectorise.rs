//! Loops compiled twice, the second time for the wider vector registers of the machine that runs
//! them.
//!
//! A binary is built for the smallest machine, and detects the vector instructions at run time. The
//! loops use no fused multiplications and sum in a fixed order, so both versions give the same
//! bits.

use faer::traits::pulp::{Arch, Simd, WithSimd};

/// Runs `task` with the vector instructions of `machine`.
///
/// Only code inlined into `task` uses them: mark `task`, and what it calls, `#[inline(always)]`.
#[inline]
pub(crate) fn vectorise<R>(machine: Arch, task: impl FnMut() -> R) -> R {
    machine.dispatch(Task(task))
}

/// A closure called as `FnMut`. pulp would call it as `FnOnce`, through a shim that is not inlined.
struct Task<F>(F);

impl<R, F: FnMut() -> R> WithSimd for Task<F> {
    type Output = R;

    #[expect(
        clippy::inline_always,
        reason = "must be inlined to use the vector features of its caller"
    )]
    #[inline(always)]
    fn with_simd<S: Simd>(mut self, _: S) -> R {
        (self.0)()
    }
}
