//! A key and its values.

use haptimill_protocol::text::AxisKind;
use std::fmt::Write as _;

/// A key of a machine file.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Key {
    /// Name in the file; of a linear axis where `rotary` has another one.
    pub name: &'static str,
    /// Allowed values.
    pub values: Values,
    /// Name and allowed values for a rotary axis, where they differ.
    pub rotary: Option<(&'static str, Values)>,
    /// Allowed values for a multi-turn rotary joint, where they differ from those of one turn.
    pub multi_turn: Option<Values>,
    /// Value without the key.
    pub default: Default,
    /// The key applies where another key of the section has this word.
    pub condition: Option<(&'static str, &'static str)>,
    /// Machines to which the key applies; empty for all.
    pub machines: &'static str,
    /// Bounds besides the range, such as those that depend on other keys; empty for none.
    pub bounds: &'static str,
    /// What to do about a number out of range instead of changing it, by kind of axis: linear,
    /// rotary, multi-turn; empty for nothing.
    pub beyond: [&'static str; 3],
    /// Meaning, in one sentence.
    pub meaning: &'static str,
}

/// Allowed values of a key.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Values {
    /// Numbers.
    Number {
        /// Smallest value.
        low: f64,
        /// Largest value.
        high: f64,
        /// Unit; empty for a plain number.
        unit: &'static str,
        /// Only whole numbers are allowed.
        whole: bool,
        /// How many numbers: 1, or the length of a list.
        count: usize,
    },
    /// 1 or -1.
    Direction,
    /// `true` or `false`.
    Flag,
    /// A text; the string describes it.
    Text(&'static str),
    /// One of these words.
    Word(&'static [&'static str]),
    /// A word of a list that the reader has: the models, or names of the machine.
    Name(&'static str),
    /// A list of some of these words.
    Words(&'static [&'static str]),
    /// A value of another form; the string describes it.
    Other(&'static str),
}

/// Value of a key that a file does not have.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Default {
    /// The key is required.
    Required,
    /// This number.
    Number(f64),
    /// A value that the text describes, as it is written in a file where it is a fixed one.
    Text(&'static str),
    /// The part of the machine that the key describes does not exist.
    Absent,
}

/// A section, `[path]` or `[[path]]`, and its keys.
#[derive(Debug, Clone, Copy)]
pub struct Section {
    /// Path without list indices, such as `joint.drive`.
    pub path: &'static str,
    /// Model of the machine to which the section belongs; `None` for all.
    pub model: Option<&'static str>,
    /// What the section describes, in one sentence.
    pub title: &'static str,
    /// Its keys, in the order of the documentation.
    pub keys: &'static [Key],
}

/// Allows real numbers from `low` to `high`.
pub const fn real(low: f64, high: f64, unit: &'static str) -> Values {
    Values::Number {
        low,
        high,
        unit,
        whole: false,
        count: 1,
    }
}

/// Allows whole numbers from `low` to `high`.
pub const fn whole(low: u32, high: u32, unit: &'static str) -> Values {
    Values::Number {
        low: low as f64,
        high: high as f64,
        unit,
        whole: true,
        count: 1,
    }
}

/// Allows lists of `count` numbers from `low` to `high`.
pub const fn list(count: usize, low: f64, high: f64, unit: &'static str) -> Values {
    Values::Number {
        low,
        high,
        unit,
        whole: false,
        count,
    }
}

/// Allows 1 and -1.
pub const fn plus_minus() -> Values {
    Values::Direction
}

/// Allows `true` and `false`.
pub const fn flag() -> Values {
    Values::Flag
}

/// Allows a text.
pub const fn text(description: &'static str) -> Values {
    Values::Text(description)
}

/// Allows one of these words.
pub const fn word(words: &'static [&'static str]) -> Values {
    Values::Word(words)
}

/// Allows a word of a list that the reader has.
pub const fn named(description: &'static str) -> Values {
    Values::Name(description)
}

/// Allows a list of some of these words.
pub const fn words(words: &'static [&'static str]) -> Values {
    Values::Words(words)
}

/// Allows what the text describes.
pub const fn other(description: &'static str) -> Values {
    Values::Other(description)
}

impl Values {
    /// Makes a required key of these values, with its meaning.
    #[must_use]
    pub const fn is(self, meaning: &'static str) -> Key {
        Key {
            name: "",
            values: self,
            rotary: None,
            multi_turn: None,
            default: match self {
                Self::Direction => Default::Number(1.0),
                _ => Default::Required,
            },
            condition: None,
            machines: "",
            bounds: "",
            beyond: [""; 3],
            meaning,
        }
    }

    /// The unit; empty for a plain number and for anything else.
    #[must_use]
    pub const fn unit(&self) -> &'static str {
        match self {
            Self::Number { unit, .. } => unit,
            _ => "",
        }
    }

    /// The allowed values without their unit.
    #[must_use]
    pub fn range(&self) -> String {
        let quoted = |words: &[&str]| -> String {
            let words: Vec<_> = words.iter().map(|word| format!("\"{word}\"")).collect();
            words.join(", ")
        };
        match *self {
            Self::Number {
                low,
                high,
                whole,
                count,
                ..
            } => {
                let mut text = String::new();
                if count != 1 {
                    let _ = write!(text, "{count} numbers, ");
                }
                let _ = match high.is_finite() {
                    true => write!(text, "{} to {}", number_text(low), number_text(high)),
                    false => write!(text, "{} to inf", number_text(low)),
                };
                if whole {
                    text.push_str(", whole");
                }
                text
            }
            Self::Direction => "1, -1".to_string(),
            Self::Flag => "true, false".to_string(),
            Self::Word(words) => quoted(words),
            Self::Words(words) => format!("list of {}", quoted(words)),
            Self::Text(text) | Self::Name(text) | Self::Other(text) => text.to_string(),
        }
    }
}

impl Key {
    /// Returns the key for an axis of a kind.
    #[must_use]
    pub const fn of(mut self, kind: AxisKind) -> Self {
        if kind.is_rotary()
            && let Some((name, values)) = self.rotary
        {
            self.name = name;
            self.values = values;
        }
        if matches!(kind, AxisKind::MultiTurn)
            && let Some(values) = self.multi_turn
        {
            self.values = values;
        }
        self.rotary = None;
        self.multi_turn = None;
        self.beyond = [self.beyond[match kind {
            AxisKind::Linear => 0,
            AxisKind::Rotary => 1,
            AxisKind::MultiTurn => 2,
        }]; 3];
        self
    }

    /// The default as it is written in a file or on a page; `None` for a required key.
    #[must_use]
    pub fn default_text(&self) -> Option<String> {
        match self.default {
            Default::Required => None,
            Default::Number(value) => Some(number_text(value)),
            Default::Text(text) => Some(text.to_string()),
            Default::Absent => Some("none".to_string()),
        }
    }

    /// Where the key applies; empty for everywhere.
    #[must_use]
    pub fn applies(&self) -> String {
        match (self.condition, self.machines) {
            (None, machines) => machines.to_string(),
            (Some((key, word)), "") => format!("{key} = \"{word}\""),
            (Some((key, word)), machines) => format!("{key} = \"{word}\", {machines}"),
        }
    }

    /// Makes the key optional, with a number as its default.
    #[must_use]
    pub const fn or(mut self, default: f64) -> Self {
        self.default = Default::Number(default);
        self
    }

    /// Makes the key optional, with a default that the text describes.
    #[must_use]
    pub const fn or_text(mut self, default: &'static str) -> Self {
        self.default = Default::Text(default);
        self
    }

    /// Makes the key optional: without it the part that it describes does not exist.
    #[must_use]
    pub const fn or_absent(mut self) -> Self {
        self.default = Default::Absent;
        self
    }

    /// Gives the key a name of its own, unlike that of its constant.
    #[must_use]
    pub const fn named(mut self, name: &'static str) -> Self {
        self.name = name;
        self
    }

    /// Gives the key another name and other values for a rotary axis.
    #[must_use]
    pub const fn rotary(mut self, name: &'static str, values: Values) -> Self {
        self.rotary = Some((name, values));
        self
    }

    /// Gives the key other values for a multi-turn rotary joint.
    #[must_use]
    pub const fn multi_turn(mut self, values: Values) -> Self {
        self.multi_turn = Some(values);
        self
    }

    /// Limits the key to sections in which another key has this word.
    #[must_use]
    pub const fn only_if(mut self, key: &'static str, word: &'static str) -> Self {
        self.condition = Some((key, word));
        self
    }

    /// Limits the key to sections in which another key has a word, unless it is limited already.
    #[must_use]
    pub const fn within(mut self, condition: Option<(&'static str, &'static str)>) -> Self {
        if self.condition.is_none() {
            self.condition = condition;
        }
        self
    }

    /// Limits the key to some machines.
    #[must_use]
    pub const fn only(mut self, machines: &'static str) -> Self {
        self.machines = machines;
        self
    }

    /// States bounds besides the range.
    #[must_use]
    pub const fn bounded(mut self, bounds: &'static str) -> Self {
        self.bounds = bounds;
        self
    }

    /// States what to do about a number out of range, by kind of axis.
    #[must_use]
    pub const fn beyond(mut self, beyond: [&'static str; 3]) -> Self {
        self.beyond = beyond;
        self
    }

    /// Gives the key the name of its constant, unless it has one.
    #[must_use]
    pub const fn constant(self, name: &'static str) -> Self {
        if self.name.is_empty() {
            self.named(name)
        } else {
            self
        }
    }
}

/// A number as it is written on a page: plain, and with an exponent from 1e6 on and below 1e-4.
#[must_use]
pub fn number_text(value: f64) -> String {
    let size = value.abs();
    if size != 0.0 && size.is_finite() && !(1e-4..1e6).contains(&size) {
        format!("{value:e}")
    } else {
        format!("{value}")
    }
}

/// Defines the module of a section, with a constant for each key and the constant `SECTION`.
#[doc(hidden)]
#[macro_export]
macro_rules! section {
    (
        $module:ident ($path:expr, $model:expr, $condition:expr)
        $title:literal { $($name:ident = $key:expr;)* }
    ) => {
        #[doc = $title]
        #[allow(
            non_upper_case_globals,
            unused_imports,
            reason = "a constant has the name of its key"
        )]
        pub mod $module {
            use $crate::*;

            $(
                #[doc = concat!("Key `", stringify!($name), "` of section `", $path, "`.")]
                pub const $name: Key = $key.constant(stringify!($name)).within($condition);
            )*

            /// The section.
            pub const SECTION: Section = Section {
                path: $path,
                model: $model,
                title: $title,
                keys: &[$($name),*],
            };
        }
    };
}

/// Defines the sections of a file of the table: a module for each, with a constant for each key,
/// and the list `SECTIONS`.
macro_rules! sections {
    ($($module:ident $path:literal $title:literal { $($name:ident = $key:expr;)* })*) => {
        $($crate::section! {
            $module ($path, None, None) $title { $($name = $key;)* }
        })*

        /// The sections of this file.
        pub const SECTIONS: &[$crate::Section] = &[$($module::SECTION),*];
    };
}

pub(crate) use sections;

/// Defines the keys of a model: those of `[kinematics]` in a module `kinematics`, and those of
/// `[plant.geometry.MODEL]` in a module `plant`. A module has a constant for each key, and the
/// constant `SECTION`.
///
/// ```
/// haptimill_machine_keys::model_keys! {
///     "crane"
///     kinematics "The lengths of the crane." {
///         boom = real(1.0, 500.0, "mm").is("length of the boom");
///     }
///     plant "The true lengths of the crane." {
///         boom = real(1.0, 500.0, "mm").is("as in `[kinematics]`");
///     }
/// }
/// assert_eq!(kinematics::boom.condition, Some(("model", "crane")));
/// assert_eq!(plant::SECTION.path, "plant.geometry.crane");
/// ```
#[macro_export]
macro_rules! model_keys {
    (
        $code:literal
        kinematics $title:literal { $($name:ident = $key:expr;)* }
        plant $plant_title:literal { $($plant_name:ident = $plant_key:expr;)* }
    ) => {
        $crate::section! {
            kinematics ("kinematics", Some($code), Some(("model", $code)))
            $title { $($name = $key;)* }
        }
        $crate::section! {
            plant (concat!("plant.geometry.", $code), Some($code), None)
            $plant_title { $($plant_name = $plant_key;)* }
        }
    };
}
