//! Minimum zones by linear programming: the parameters of a form are changed until the largest
//! deviation of its points is smallest.

use microlp::{ComparisonOp, OptimizationDirection, Problem, SolveOutcome};

/// Rounds of linearisation; each one squares the error of the one before.
const ROUNDS: usize = 6;

/// Smallest range of deviations that changes of `N` parameters give, near their present values.
///
/// `deviations` gives, for each point, the deviation and its derivatives by the parameters.
/// The parameters are changed in place.
pub(super) fn minimum_zone<const N: usize>(
    parameters: &mut [f64; N],
    deviations: impl Fn(&[f64; N]) -> Vec<(f64, [f64; N])>,
) -> f64 {
    let width = |rows: &[(f64, [f64; N])]| {
        let values: Vec<f64> = rows.iter().map(|row| row.0).collect();
        super::range(&values)
    };
    let mut rows = deviations(parameters);
    let mut best = width(&rows);
    for _ in 0..ROUNDS {
        let Some(step) = chebyshev_step(&rows, best) else {
            break;
        };
        let mut next = *parameters;
        for (parameter, step) in next.iter_mut().zip(step) {
            *parameter += step;
        }
        let changed = deviations(&next);
        let reached = width(&changed);
        if reached >= best {
            break;
        }
        (*parameters, rows, best) = (next, changed, reached);
    }
    best
}

/// The step that minimises the range of the linearised deviations. The unit of the program is the
/// present range, so that its tolerances are relative to it.
fn chebyshev_step<const N: usize>(rows: &[(f64, [f64; N])], unit: f64) -> Option<[f64; N]> {
    if unit <= 0.0 {
        return None;
    }
    let free = (f64::NEG_INFINITY, f64::INFINITY);
    let mut problem = Problem::new(OptimizationDirection::Minimize);
    let low = problem.add_var(-1.0, free);
    let high = problem.add_var(1.0, free);
    let steps: [_; N] = core::array::from_fn(|_| problem.add_var(0.0, free));
    for (deviation, slopes) in rows {
        let mut terms: Vec<_> = steps.iter().copied().zip(slopes.iter().copied()).collect();
        let value = -deviation / unit;
        terms.push((low, -1.0));
        problem.add_constraint(&terms, ComparisonOp::Ge, value);
        if let Some(last) = terms.last_mut() {
            last.0 = high;
        }
        problem.add_constraint(&terms, ComparisonOp::Le, value);
    }
    let SolveOutcome::Solution(solution) = problem.solve().ok()? else {
        return None;
    };
    Some(steps.map(|step| solution[step] * unit))
}
