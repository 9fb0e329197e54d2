//! Statistics with which the thesis compares the model with the part: trend curves, correlation and
//! its significance.

use nalgebra::{DMatrix, DVector};

/// Smallest singular value of equations that counts; their coefficients are scaled to one.
pub(crate) const SINGULAR: f64 = 1e-9;

/// Pearson's correlation coefficient of two series; 0 where one of them is constant.
#[must_use]
pub fn pearson(x: &[f64], y: &[f64]) -> f64 {
    let count = x.len().min(y.len()) as f64;
    let mean = |values: &[f64]| values.iter().sum::<f64>() / count;
    let (mx, my) = (mean(x), mean(y));
    let sum = |a: &[f64], ma: f64, b: &[f64], mb: f64| -> f64 {
        a.iter().zip(b).map(|(a, b)| (a - ma) * (b - mb)).sum()
    };
    let product = sum(x, mx, x, mx) * sum(y, my, y, my);
    if product > 0.0 {
        sum(x, mx, y, my) / product.sqrt()
    } else {
        0.0
    }
}

/// Classes of a correlation coefficient: low up to 0.3, medium up to 0.7, high up to 0.9, then very
/// high.
#[must_use]
pub fn class(r: f64) -> &'static str {
    match r.abs() {
        r if r <= 0.3 => "low",
        r if r <= 0.7 => "medium",
        r if r <= 0.9 => "high",
        _ => "very high",
    }
}

/// Student's t of a correlation coefficient of `count` pairs, with `count` - 2 degrees of freedom.
#[must_use]
pub fn t_of_correlation(r: f64, count: usize) -> f64 {
    r * (count as f64 - 2.0).sqrt() / (1.0 - r * r).sqrt()
}

/// Probability of a t at least as large in magnitude without a correlation: Student's distribution
/// with at least one degree of freedom, two-tailed.
///
/// Source: M. Abramowitz, I. Stegun, *Handbook of Mathematical Functions*, 26.7.3 and 26.7.4.
#[must_use]
pub fn p_of_t(t: f64, degrees: u32) -> f64 {
    let angle = (t.abs() / f64::from(degrees).sqrt()).atan();
    let (sine, cosine) = angle.sin_cos();
    // Odd: cos + 2/3 cos^3 + 2/3 4/5 cos^5 ...; even: 1 + 1/2 cos^2 + 1/2 3/4 cos^4 ...; both up to
    // the power degrees - 2.
    let is_odd = !degrees.is_multiple_of(2);
    let first = u32::from(is_odd);
    let (mut term, mut sum) = (if is_odd { cosine } else { 1.0 }, 0.0);
    for power in (first..degrees.saturating_sub(1)).step_by(2) {
        sum += term;
        let power = f64::from(power);
        term *= cosine * cosine * (power + 1.0) / (power + 2.0);
    }
    let within = if is_odd {
        core::f64::consts::FRAC_2_PI * (angle + sine * sum)
    } else {
        sine * sum
    };
    1.0 - within
}

/// A polynomial, the coefficients of rising powers of u / `scale`.
#[derive(Debug, Clone, PartialEq)]
pub struct Polynomial {
    /// Coefficients.
    pub coefficients: Vec<f64>,
    /// Unit of the argument.
    pub scale: f64,
    /// Part of the variance that it explains, R squared.
    pub r_squared: f64,
}

impl Polynomial {
    /// Value at u.
    #[must_use]
    pub fn value(&self, u: f64) -> f64 {
        let u = u / self.scale;
        self.coefficients
            .iter()
            .rev()
            .fold(0.0, |value, c| value * u + c)
    }

    /// Coefficient of a power of u itself.
    #[must_use]
    pub fn coefficient(&self, power: usize) -> f64 {
        let unit = self.scale.powi(i32::try_from(power).unwrap_or(i32::MAX));
        self.coefficients.get(power).copied().unwrap_or(0.0) / unit
    }
}

/// Fits a polynomial by least squares; `None` with too few different points.
#[must_use]
pub fn fit_polynomial(u: &[f64], v: &[f64], degree: usize) -> Option<Polynomial> {
    let scale = u.iter().fold(0.0_f64, |largest, u| largest.max(u.abs()));
    if scale <= 0.0 || u.len() != v.len() || u.len() <= degree {
        return None;
    }
    let powers = DMatrix::from_fn(u.len(), degree + 1, |row, power| {
        (u[row] / scale).powi(power as i32)
    });
    let fit = powers.svd(true, true);
    if fit.rank(SINGULAR) <= degree {
        return None;
    }
    let coefficients = fit.solve(&DVector::from_column_slice(v), 0.0).ok()?;
    let mut fitted = Polynomial {
        coefficients: coefficients.as_slice().to_vec(),
        scale,
        r_squared: 0.0,
    };
    let mean = v.iter().sum::<f64>() / v.len() as f64;
    let total: f64 = v.iter().map(|v| (v - mean) * (v - mean)).sum();
    let rest: f64 = u
        .iter()
        .zip(v)
        .map(|(u, v)| (v - fitted.value(*u)).powi(2))
        .sum();
    fitted.r_squared = if total > 0.0 { 1.0 - rest / total } else { 1.0 };
    Some(fitted)
}

/// Degree of the polynomial from which one more degree gains less than 0.01 of R squared.
#[must_use]
pub fn choose_degree(u: &[f64], v: &[f64], largest: usize) -> Option<Polynomial> {
    let mut chosen = fit_polynomial(u, v, 1)?;
    for degree in 2..=largest {
        let next = fit_polynomial(u, v, degree)?;
        if degree > 2 && next.r_squared - chosen.r_squared < 0.01 {
            break;
        }
        chosen = next;
    }
    Some(chosen)
}

/// A natural cubic spline through points: its second derivative is zero at both ends.
#[derive(Debug, Clone, PartialEq)]
pub struct Spline {
    u: Vec<f64>,
    v: Vec<f64>,
    second: Vec<f64>,
}

impl Spline {
    /// The spline through points with ascending u; `None` with fewer than two of them.
    #[must_use]
    pub fn new(u: &[f64], v: &[f64]) -> Option<Self> {
        let count = u.len();
        if count < 2 || count != v.len() || u.windows(2).any(|pair| pair[0] >= pair[1]) {
            return None;
        }
        let mut matrix = DMatrix::identity(count, count);
        let mut right = DVector::zeros(count);
        for i in 1..count - 1 {
            let (before, after) = (u[i] - u[i - 1], u[i + 1] - u[i]);
            matrix[(i, i - 1)] = before;
            matrix[(i, i)] = 2.0 * (before + after);
            matrix[(i, i + 1)] = after;
            right[i] = 6.0 * ((v[i + 1] - v[i]) / after - (v[i] - v[i - 1]) / before);
        }
        let second = matrix.lu().solve(&right)?;
        Some(Self {
            u: u.to_vec(),
            v: v.to_vec(),
            second: second.as_slice().to_vec(),
        })
    }

    /// Value at u; beyond the ends the outermost cubic goes on.
    #[must_use]
    pub fn value(&self, u: f64) -> f64 {
        let upper = self
            .u
            .partition_point(|node| *node <= u)
            .clamp(1, self.u.len() - 1);
        let (a, b) = (self.u[upper - 1], self.u[upper]);
        let h = b - a;
        let (left, right) = ((b - u) / h, (u - a) / h);
        let cubic = |part: f64| (part * part * part - part) * h * h / 6.0;
        left * self.v[upper - 1]
            + right * self.v[upper]
            + cubic(left) * self.second[upper - 1]
            + cubic(right) * self.second[upper]
    }

    /// Second derivative at the ends.
    #[must_use]
    pub fn ends(&self) -> [f64; 2] {
        [self.second[0], self.second[self.second.len() - 1]]
    }
}
