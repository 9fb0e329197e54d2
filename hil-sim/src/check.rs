//! Problems of a plant configuration, and the list that collects them.

use core::fmt;

/// A problem of a [`PlantConfig`](crate::config::PlantConfig).
#[derive(Debug, Clone, PartialEq)]
pub struct PlantError {
    /// Path of the field: `joint 2: motor_share`.
    pub field: String,
    /// The problem, with the value, the allowed range and the remedy.
    pub problem: String,
}

impl fmt::Display for PlantError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "plant: {}: {}", self.field, self.problem)
    }
}

impl core::error::Error for PlantError {}

/// Collects all problems, so that a user can correct a machine file in one pass.
#[derive(Default)]
pub struct Check(Vec<PlantError>);

impl Check {
    /// Adds a problem of a field.
    pub fn refuse(&mut self, field: String, problem: String) {
        self.0.push(PlantError { field, problem });
    }

    /// Adds a problem if a value is not within its bounds.
    pub fn within(&mut self, field: String, value: f64, low: f64, high: f64) {
        let remedy = if value > high {
            "lower it"
        } else if value < low {
            "raise it"
        } else if value.is_nan() {
            "write a number"
        } else {
            return;
        };
        let problem = format!("{value} is out of range, allowed is {low} to {high}; {remedy}");
        self.refuse(field, problem);
    }

    /// The problems, if there are any.
    ///
    /// # Errors
    /// All problems that were added.
    pub fn done(self) -> Result<(), Vec<PlantError>> {
        if self.0.is_empty() {
            Ok(())
        } else {
            Err(self.0)
        }
    }
}
