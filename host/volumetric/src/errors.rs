//! The 21 geometric errors of a machine with three linear axes, by their names of ISO 230-1.
//!
//! An axis that moves has six errors, functions of its position: three translations and three
//! rotations. `EYX` is the translation along Y of the motion along X, `EBX` the rotation about Y
//! (B) of the same motion. Three more numbers state how far the axes are out of square.

use core::f64::consts::TAU;
use core::fmt;

/// A linear axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Axis {
    /// Along x.
    X,
    /// Along y.
    Y,
    /// Along z.
    Z,
}

impl Axis {
    /// All axes, in the order of the coordinates.
    pub const ALL: [Self; 3] = [Self::X, Self::Y, Self::Z];

    /// Index of the coordinate.
    #[must_use]
    pub const fn index(self) -> usize {
        self as usize
    }

    /// Letter of the axis.
    #[must_use]
    pub const fn letter(self) -> char {
        ['X', 'Y', 'Z'][self as usize]
    }

    /// Letter of the rotation about the axis.
    #[must_use]
    pub const fn rotation_letter(self) -> char {
        ['A', 'B', 'C'][self as usize]
    }
}

/// Kind of an error.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Kind {
    /// Translation along the motion: positioning (scale).
    Positioning,
    /// Translation across the motion.
    Straightness,
    /// Rotation about the motion.
    Roll,
    /// Rotation about the horizontal axis across the motion; about X for a vertical motion.
    Pitch,
    /// Rotation about the vertical axis; about Y for a vertical motion.
    Yaw,
    /// Angle between two axes, less 90 degrees.
    Squareness,
}

/// One of the 18 error functions: translation along, or rotation about, one axis while another one,
/// or the same one, moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Function {
    /// The axis that moves.
    pub moving: Axis,
    /// Direction of the translation, or axis of the rotation.
    pub direction: Axis,
    /// A rotation.
    pub rotates: bool,
}

impl Function {
    /// All functions: for each axis that moves three translations, then three rotations.
    pub fn all() -> impl Iterator<Item = Self> {
        Axis::ALL.into_iter().flat_map(|moving| {
            [false, true].into_iter().flat_map(move |rotates| {
                Axis::ALL.into_iter().map(move |direction| Self {
                    moving,
                    direction,
                    rotates,
                })
            })
        })
    }

    /// Place in the order of [`Function::all`].
    #[must_use]
    pub const fn index(self) -> usize {
        self.moving.index() * 6 + self.rotates as usize * 3 + self.direction.index()
    }

    /// Kind of the error.
    #[must_use]
    pub fn kind(self) -> Kind {
        match (self.rotates, self.moving, self.direction) {
            (false, moving, direction) if moving == direction => Kind::Positioning,
            (false, ..) => Kind::Straightness,
            (true, moving, direction) if moving == direction => Kind::Roll,
            (true, Axis::Z, Axis::X) | (true, Axis::X, Axis::Y) | (true, Axis::Y, Axis::X) => {
                Kind::Pitch
            }
            (true, ..) => Kind::Yaw,
        }
    }

    /// The function of a name such as `EYX`, `E_YX` or `YX`.
    #[must_use]
    pub fn of_name(name: &str) -> Option<Self> {
        let name = name.strip_prefix("E_").or(name.strip_prefix('E'));
        let all = Self::all().map(|function| (function.to_string(), function));
        let name = format!("E{}", name?);
        all.into_iter()
            .find(|(known, _)| *known == name)
            .map(|(_, function)| function)
    }

    /// Unit of the values in files.
    #[must_use]
    pub const fn unit(self) -> &'static str {
        if self.rotates { "urad" } else { "um" }
    }

    /// Value of one unit of a file, in mm or radians.
    #[must_use]
    pub const fn file_unit(self) -> f64 {
        if self.rotates { 1e-6 } else { 1e-3 }
    }
}

impl fmt::Display for Function {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let first = if self.rotates {
            self.direction.rotation_letter()
        } else {
            self.direction.letter()
        };
        write!(f, "E{first}{}", self.moving.letter())
    }
}

/// Squareness errors, radians: the rotation of the second axis of each name relative to the first.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Squareness {
    /// `EC0Y`: y to x, about z.
    pub c0y: f64,
    /// `EB0Z`: z to x, about y.
    pub b0z: f64,
    /// `EA0Z`: z to y, about x.
    pub a0z: f64,
}

impl Squareness {
    /// Names of the three, in the order of the fields.
    pub const NAMES: [&'static str; 3] = ["EC0Y", "EB0Z", "EA0Z"];

    /// The three in the order of the names.
    #[must_use]
    pub const fn values(&self) -> [f64; 3] {
        [self.c0y, self.b0z, self.a0z]
    }

    /// Squareness errors in the order of the names.
    #[must_use]
    pub const fn of_values([c0y, b0z, a0z]: [f64; 3]) -> Self {
        Self { c0y, b0z, a0z }
    }
}

/// Direction in which an axis came to its position.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Approach {
    /// Unknown, or without effect: the mean of both directions.
    #[default]
    Any,
    /// Upwards.
    Up,
    /// Downwards.
    Down,
}

/// Values at nodes, linear between them and constant beyond them.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Table {
    /// Positions of the nodes, mm, ascending.
    pub nodes: Vec<f64>,
    /// Values for motion upwards, mm or radians.
    pub up: Vec<f64>,
    /// Values for motion downwards, where they differ.
    pub down: Option<Vec<f64>>,
}

impl Table {
    /// The same values in both directions.
    #[must_use]
    pub const fn both(nodes: Vec<f64>, values: Vec<f64>) -> Self {
        Self {
            nodes,
            up: values,
            down: None,
        }
    }

    /// Value at a position; 0 without nodes.
    #[must_use]
    pub fn value(&self, position: f64, approach: Approach) -> f64 {
        let up = || interpolate(&self.nodes, &self.up, position);
        match (&self.down, approach) {
            (None, _) | (_, Approach::Up) => up(),
            (Some(down), Approach::Down) => interpolate(&self.nodes, down, position),
            (Some(down), Approach::Any) => 0.5 * (up() + interpolate(&self.nodes, down, position)),
        }
    }

    /// Steepest slope between two nodes, per mm, with the lower node.
    #[must_use]
    pub fn steepest(&self) -> Option<(f64, f64)> {
        let columns = [Some(&self.up), self.down.as_ref()];
        let slopes = columns.into_iter().flatten().flat_map(|values| {
            let nodes = self.nodes.windows(2).zip(values.windows(2));
            nodes.map(|(at, value)| (at[0], (value[1] - value[0]) / (at[1] - at[0])))
        });
        slopes.max_by(|(_, a), (_, b)| a.abs().total_cmp(&b.abs()))
    }
}

/// Linear interpolation in a table, constant beyond its ends; 0 for an empty one.
#[must_use]
pub fn interpolate(nodes: &[f64], values: &[f64], position: f64) -> f64 {
    let after = nodes.partition_point(|node| *node <= position);
    match (after.checked_sub(1), nodes.get(after)) {
        (None, _) => values.first().copied().unwrap_or(0.0),
        (Some(last), None) => values.get(last).copied().unwrap_or(0.0),
        (Some(before), Some(end)) => {
            let part = (position - nodes[before]) / (end - nodes[before]);
            values[before] + part * (values[after] - values[before])
        }
    }
}

/// A mean, a slope and two sines.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ClosedForm {
    /// Value at 0, mm or radians, without the sines.
    pub mean: f64,
    /// Change per mm.
    pub slope: f64,
    /// Amplitude, wavelength in mm and phase in radians of each sine; a wavelength of 0 is none.
    pub sines: [[f64; 3]; 2],
}

impl ClosedForm {
    /// Value at a position.
    #[must_use]
    pub fn value(&self, position: f64) -> f64 {
        let sine = |[amplitude, wavelength, phase]: [f64; 3]| {
            if wavelength == 0.0 {
                0.0
            } else {
                amplitude * libm::sin(TAU * position / wavelength + phase)
            }
        };
        let sines: f64 = self.sines.into_iter().map(sine).sum();
        self.mean + self.slope * position + sines
    }
}

/// An error function.
#[derive(Debug, Clone, PartialEq)]
pub enum Shape {
    /// Values at nodes.
    Table(Table),
    /// A formula.
    ClosedForm(ClosedForm),
}

impl Shape {
    /// Value at a position.
    #[must_use]
    pub fn value(&self, position: f64, approach: Approach) -> f64 {
        match self {
            Self::Table(table) => table.value(position, approach),
            Self::ClosedForm(form) => form.value(position),
        }
    }
}

/// The 21 errors of a machine.
#[derive(Debug, Clone, PartialEq)]
pub struct ErrorSet {
    functions: [Shape; 18],
    /// Squareness errors.
    pub squareness: Squareness,
}

impl Default for ErrorSet {
    /// A machine without an error.
    fn default() -> Self {
        Self {
            functions: core::array::from_fn(|_| Shape::ClosedForm(ClosedForm::default())),
            squareness: Squareness::default(),
        }
    }
}

/// Translation and rotation of one axis at its position.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct AxisError {
    /// Translation, mm.
    pub translation: crate::Vector,
    /// Rotation, radians.
    pub rotation: crate::Vector,
}

impl ErrorSet {
    /// An error function.
    #[must_use]
    pub const fn function(&self, function: Function) -> &Shape {
        &self.functions[function.index()]
    }

    /// Replaces an error function.
    pub fn set(&mut self, function: Function, shape: Shape) {
        self.functions[function.index()] = shape;
    }

    /// The same set without some of its functions.
    #[must_use]
    pub fn without(&self, is_omitted: impl Fn(Function) -> bool) -> Self {
        let mut set = self.clone();
        for function in Function::all().filter(|function| is_omitted(*function)) {
            set.set(function, Shape::ClosedForm(ClosedForm::default()));
        }
        set
    }

    /// Translation and rotation of an axis at its position.
    #[must_use]
    pub fn of_axis(&self, moving: Axis, position: f64, approach: Approach) -> AxisError {
        let value = |rotates, direction| {
            let function = Function {
                moving,
                direction,
                rotates,
            };
            self.function(function).value(position, approach)
        };
        let vector = |rotates| {
            let [x, y, z] = Axis::ALL.map(|direction| value(rotates, direction));
            crate::Vector::new(x, y, z)
        };
        AxisError {
            translation: vector(false),
            rotation: vector(true),
        }
    }

    /// The set with every error multiplied: a worn machine.
    #[must_use]
    pub fn scaled(&self, by: f64) -> Self {
        let scale = |values: &Vec<f64>| values.iter().map(|value| value * by).collect();
        let functions = self.functions.clone().map(|shape| match shape {
            Shape::Table(table) => Shape::Table(Table {
                up: scale(&table.up),
                down: table.down.as_ref().map(scale),
                nodes: table.nodes,
            }),
            Shape::ClosedForm(form) => Shape::ClosedForm(ClosedForm {
                mean: form.mean * by,
                slope: form.slope * by,
                sines: form
                    .sines
                    .map(|[a, wavelength, phase]| [a * by, wavelength, phase]),
            }),
        });
        Self {
            functions,
            squareness: Squareness::of_values(self.squareness.values().map(|value| value * by)),
        }
    }

    /// The set as tables with evenly spaced nodes: `counts` of them from `low` to `high` of each
    /// axis. A table with these nodes keeps its values exactly.
    #[must_use]
    pub fn tabulated(&self, travel: &[(f64, f64); 3], counts: [usize; 3]) -> Self {
        let mut set = self.clone();
        for function in Function::all() {
            let axis = function.moving.index();
            let nodes = even_nodes(travel[axis], counts[axis]);
            let shape = self.function(function);
            let values = |approach| -> Vec<f64> {
                let nodes = nodes.iter();
                nodes.map(|node| shape.value(*node, approach)).collect()
            };
            let (up, down) = (values(Approach::Up), values(Approach::Down));
            let down = (up != down).then_some(down);
            let nodes = nodes.clone();
            set.set(function, Shape::Table(Table { nodes, up, down }));
        }
        set
    }
}

/// Evenly spaced positions from `low` to `high`.
#[must_use]
pub fn even_nodes((low, high): (f64, f64), count: usize) -> Vec<f64> {
    let pitch = (high - low) / (count.max(2) - 1) as f64;
    (0..count.max(2))
        .map(|node| low + pitch * node as f64)
        .collect()
}
