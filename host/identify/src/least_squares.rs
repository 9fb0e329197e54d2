//! Linear least squares by normal equations.

/// Solves a system of equations in place by elimination with pivoting; `None` if it is singular.
#[allow(clippy::needless_range_loop)]
pub fn solve<const N: usize>(mut a: [[f64; N]; N], mut b: [f64; N]) -> Option<[f64; N]> {
    for column in 0..N {
        let pivot =
            (column..N).max_by(|p, q| a[*p][column].abs().total_cmp(&a[*q][column].abs()))?;
        if a[pivot][column].abs() < 1e-300 {
            return None;
        }
        a.swap(column, pivot);
        b.swap(column, pivot);
        for row in column + 1..N {
            let factor = a[row][column] / a[column][column];
            for k in column..N {
                a[row][k] -= factor * a[column][k];
            }
            b[row] -= factor * b[column];
        }
    }
    for row in (0..N).rev() {
        for k in row + 1..N {
            b[row] -= a[row][k] * b[k];
        }
        b[row] /= a[row][row];
    }
    b.iter().all(|value| value.is_finite()).then_some(b)
}

/// Coefficients of the regressors that fit the values best, and the rms of the residuals.
#[must_use]
pub fn fit<const N: usize>(rows: &[([f64; N], f64)]) -> Option<([f64; N], f64)> {
    let (mut normal, mut right) = ([[0.0; N]; N], [0.0; N]);
    for (row, value) in rows {
        for i in 0..N {
            for j in 0..N {
                normal[i][j] += row[i] * row[j];
            }
            right[i] += row[i] * value;
        }
    }
    let solution = solve(normal, right)?;
    let squares: f64 = rows
        .iter()
        .map(|(row, value)| {
            let fitted: f64 = row.iter().zip(solution).map(|(a, x)| a * x).sum();
            (value - fitted).powi(2)
        })
        .sum();
    Some((solution, (squares / rows.len().max(1) as f64).sqrt()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plane_is_found_exactly() {
        let rows: Vec<_> = (0..20)
            .map(|i| {
                let (x, y) = (f64::from(i % 5), f64::from(i / 5));
                ([1.0, x, y], 3.0 - 2.0 * x + 0.5 * y)
            })
            .collect();
        let (found, rms) = fit(&rows).unwrap_or_default();
        for (found, expected) in found.iter().zip([3.0, -2.0, 0.5]) {
            assert!((found - expected).abs() < 1e-12);
        }
        assert!(rms < 1e-12);
        assert!(fit(&[([1.0, 1.0], 1.0), ([1.0, 1.0], 2.0)]).is_none());
    }
}
