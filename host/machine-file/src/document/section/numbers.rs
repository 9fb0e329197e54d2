//! Numbers of a section, and the values that are allowed for them.

use super::Section;
use haptimill_machine_keys::{Default as KeyDefault, Key, Values};
use toml::Spanned;
use toml::de::DeValue;

/// Allowed values of a number.
#[derive(Debug, Clone, Copy)]
pub struct Allowed {
    /// Smallest value.
    pub low: f64,
    /// Largest value.
    pub high: f64,
    /// Unit, for the message.
    pub unit: &'static str,
    /// Whether only whole numbers are allowed.
    pub whole: bool,
    /// What to do about a number out of range instead of changing it; empty for nothing.
    pub beyond: &'static str,
}

impl Allowed {
    /// Allowed values of a key of the table for one kind of axis; all numbers where it has no
    /// range.
    fn of(key: Key) -> Self {
        match key.values {
            Values::Number {
                low,
                high,
                unit,
                whole,
                ..
            } => Self {
                low,
                high,
                unit,
                whole,
                beyond: key.beyond[0],
            },
            _ => real(f64::NEG_INFINITY, f64::INFINITY, ""),
        }
    }
}

/// Allows real numbers from `low` to `high`.
pub fn real(low: f64, high: f64, unit: &'static str) -> Allowed {
    Allowed {
        low,
        high,
        unit,
        whole: false,
        beyond: "",
    }
}

/// Allows whole numbers from `low` to `high`.
pub fn whole(low: u32, high: u32, unit: &'static str) -> Allowed {
    Allowed {
        low: f64::from(low),
        high: f64::from(high),
        unit,
        whole: true,
        beyond: "",
    }
}

impl<'i> Section<'_, 'i> {
    /// Reads a number by its row in the table of keys, or returns its default; NaN after a report
    /// and where the default is not a number.
    pub fn value(&self, key: Key) -> f64 {
        self.value_or(
            key,
            match key.default {
                KeyDefault::Number(default) => Some(default),
                KeyDefault::Required => None,
                KeyDefault::Text(_) | KeyDefault::Absent => Some(f64::NAN),
            },
        )
    }

    /// As [`Self::value`], with a default that depends on other values; `None` requires the key.
    pub fn value_or(&self, key: Key, default: Option<f64>) -> f64 {
        let key = self.key(key);
        if key.values == Values::Direction {
            return self.direction(key.name, default.unwrap_or(1.0));
        }
        let allowed = Allowed::of(key);
        match default {
            Some(default) => self.number_or(key.name, default, allowed),
            None => self.number(key.name, allowed),
        }
    }

    /// Reads a list of `N` numbers by its row in the table of keys; NaN after a report.
    pub fn values<const N: usize>(&self, key: Key) -> [f64; N] {
        let key = self.key(key);
        self.numbers(key.name, Allowed::of(key))
    }

    /// Reads a number; NaN after a report.
    pub fn number(&self, key: &'static str, allowed: Allowed) -> f64 {
        let remedy = || format!("add `{key} = ...`, {}", describe(allowed));
        self.required(key, remedy)
            .map_or(f64::NAN, |value| self.check(key, value, allowed))
    }

    /// Reads an optional number; NaN after a report.
    pub fn number_or(&self, key: &'static str, default: f64, allowed: Allowed) -> f64 {
        self.get(key)
            .map_or(default, |value| self.check(key, value, allowed))
    }

    fn check(&self, key: &'static str, value: &Spanned<DeValue<'i>>, allowed: Allowed) -> f64 {
        let number = match value.get_ref() {
            // A number beyond i128 is beyond every allowed range.
            DeValue::Integer(digits) => i128::from_str_radix(digits.as_str(), digits.radix())
                .map_or(f64::INFINITY, |n| n as f64),
            DeValue::Float(digits) => digits.as_str().parse().unwrap_or(f64::NAN),
            other => {
                self.wrong_type(key, other, "a number");
                return f64::NAN;
            }
        };
        let written = self.document.text.get(value.span()).unwrap_or("the value");
        if !number.is_finite() {
            let what = format!("`{written}` is not a finite number");
            self.report(key, what, format!("write a number, {}", describe(allowed)));
        } else if number < allowed.low || number > allowed.high {
            let what = format!("{written} is out of range, {}", describe(allowed));
            let remedy = if number < allowed.low {
                "raise"
            } else {
                "lower"
            };
            let remedy = match allowed.beyond {
                "" => format!("{remedy} it"),
                beyond => format!("{remedy} it, or {beyond}"),
            };
            self.report(key, what, remedy);
        } else if allowed.whole && number.fract() != 0.0 {
            let what = format!("{written} is not a whole number, {}", describe(allowed));
            self.report(key, what, "round it");
        } else {
            return number;
        }
        f64::NAN
    }

    /// Reads a list of `N` numbers; NaN after a report.
    pub fn numbers<const N: usize>(&self, key: &'static str, allowed: Allowed) -> [f64; N] {
        let remedy = || format!("add `{key} = [...]`, {N} numbers, {}", describe(allowed));
        match self.required(key, remedy).map(Spanned::get_ref) {
            Some(DeValue::Array(items)) if items.len() == N => {
                std::array::from_fn(|index| self.check(key, &items[index], allowed))
            }
            Some(DeValue::Array(items)) => {
                let what = format!("has {} numbers", items.len());
                self.report(key, what, format!("write {N}"));
                [f64::NAN; N]
            }
            Some(other) => {
                self.wrong_type(key, other, "a list of numbers");
                [f64::NAN; N]
            }
            None => [f64::NAN; N],
        }
    }

    /// Reads an optional list of `few` to `max` numbers, each in the range of the key `number`;
    /// empty where it is absent, or after a report.
    pub fn number_list(&self, key: Key, few: usize, max: usize, number: Key) -> Vec<f64> {
        let (key, allowed) = (self.key(key).name, Allowed::of(self.key(number)));
        let Some(value) = self.get(key) else {
            return Vec::new();
        };
        let DeValue::Array(items) = value.get_ref() else {
            self.wrong_type(key, value.get_ref(), "a list of numbers");
            return Vec::new();
        };
        if !(few..=max).contains(&items.len()) {
            let what = format!("has {} numbers", items.len());
            self.report(key, what, format!("write {few} to {max}"));
            return Vec::new();
        }
        let numbers: Vec<f64> = items
            .iter()
            .map(|item| self.check(key, item, allowed))
            .collect();
        if numbers.iter().any(|number| number.is_nan()) {
            return Vec::new();
        }
        numbers
    }

    /// Reads 1 or -1.
    fn direction(&self, key: &'static str, default: f64) -> f64 {
        let sign = self.number_or(key, default, real(-1.0, 1.0, ""));
        if sign.is_nan() || sign.abs() == 1.0 {
            return sign;
        }
        self.report(key, format!("{sign} is not a direction"), "write 1 or -1");
        f64::NAN
    }
}

fn describe(allowed: Allowed) -> String {
    let Allowed {
        low, high, unit, ..
    } = allowed;
    let space = if unit.is_empty() { "" } else { " " };
    format!("allowed is {low} to {high}{space}{unit}")
}
