//! Geometric errors of three carriages on the chain [w Y b X Z t]: the table moves along y, the
//! spindle along x, then z.
//!
//! An error file names 18 functions and 3 angles (docs/volumetric.md). The error of the tool is
//! computed by moving frames: a carriage goes to its place, is displaced and turned by its errors,
//! and carries the next frame. Rotations are exact; a squareness error is the tangent of its angle,
//! and the model of the thesis uses small angles as printed. No formula of the controller is used.
//! The errors are those of the tool relative to the workpiece, so the table takes them with the
//! opposite sign.
//!
//! Units: mm and radians; a file has um and urad.

use crate::vector::{Vector, cross, plus};
use core::f64::consts::{PI, TAU};
use serde::{Deserialize, Serialize};

/// Model that turns the errors of the carriages into the error of the tool.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ErrorModel {
    /// The frames of the machine, with squareness errors.
    #[default]
    Physical,
    /// The frames as the thesis of P. Sratong-on (Thai-Nichi Institute of Technology, 2012) places
    /// them: the work point is the arm of every rotation; no squareness errors.
    Thesis,
}

/// From the z carriage to the tool in the thesis, mm.
const THESIS_TOOL: Vector = [0.0, 0.0, -375.6991];

/// Smallest distance that a carriage moves back until its direction has changed, mm.
const REVERSAL: f64 = 0.001;

/// An error function.
#[derive(Debug, Clone, PartialEq)]
enum Function {
    /// Value, slope, and amplitude, wavelength, phase of each sine.
    Form(f64, f64, [[f64; 3]; 2]),
    /// Positions, and values upwards and downwards.
    Table(Vec<f64>, Vec<f64>, Vec<f64>),
}

/// Errors of three carriages.
#[derive(Debug, Clone, PartialEq)]
pub struct CarriageErrors {
    /// By moving carriage: translations along x, y, z, then rotations about them.
    functions: [[Function; 6]; 3],
    /// `EC0Y`, `EB0Z`, `EA0Z`.
    squareness: [f64; 3],
    model: ErrorModel,
    /// Middle of the lost motion of each carriage, mm, and the carriage's place in it: 1 after
    /// motion upwards, -1 after motion downwards.
    middle: [f64; 3],
    side: [f64; 3],
}

impl CarriageErrors {
    /// Reads an error file; `None` if it is empty.
    ///
    /// # Errors
    /// What is wrong, with its line.
    pub fn parse(text: &str, model: ErrorModel) -> Result<Option<Self>, String> {
        let lines = text
            .lines()
            .enumerate()
            .map(|(index, line)| (index + 1, line.trim()));
        let mut lines = lines.filter(|(_, line)| !line.is_empty() && !line.starts_with('#'));
        let Some((at, header)) = lines.next() else {
            return Ok(None);
        };
        let table = match header.split(',').nth(1) {
            Some("position_mm") => true,
            Some("unit") => false,
            _ => {
                return Err(format!(
                    "line {at}: \"{header}\" is not the header of an error file; write \
                     \"function,position_mm,direction,value,unit\""
                ));
            }
        };
        let mut rows: [[Vec<(f64, f64, String)>; 6]; 3] = Default::default();
        let mut forms: [[Option<Function>; 6]; 3] = Default::default();
        let mut squareness = [None; 3];
        for (at, line) in lines {
            let parts: Vec<&str> = line.split(',').map(str::trim).collect();
            let wrong = |what: &str| format!("line {at}: \"{line}\": {what}");
            if parts.len() != if table { 5 } else { 10 } {
                return Err(wrong(
                    "complete the line: it has another number of values than the header",
                ));
            }
            let number = |index: usize| {
                let number: Option<f64> = parts[index].parse().ok();
                number
                    .filter(|it| it.is_finite())
                    .ok_or_else(|| wrong("write a number in each column of values"))
            };
            let (unit, turns) = match parts[if table { 4 } else { 1 }] {
                "nm" => (1e-6, false),
                "um" => (1e-3, false),
                "mm" => (1.0, false),
                "urad" => (1e-6, true),
                "arcsec" => (PI / 648_000.0, true),
                _ => return Err(wrong("write the unit um, mm, nm, urad or arcsec")),
            };
            let name = parts[0].trim_start_matches('E');
            if let Some(index) = ["C0Y", "B0Z", "A0Z"].iter().position(|it| *it == name) {
                let value = number(if table { 3 } else { 2 })? * unit;
                if squareness[index].replace(value).is_some() {
                    return Err(wrong("remove one: this error is there twice"));
                }
                continue;
            }
            let place = |letter: Option<char>, of: &str| letter.and_then(|it| of.find(it));
            let mut letters = name.chars();
            let error = place(letters.next(), "XYZABC");
            let carriage = place(letters.next(), "XYZ");
            let (Some(error), Some(carriage), None) = (error, carriage, letters.next()) else {
                return Err(wrong(
                    "write a name such as EXX, EBY or EC0Y: this is no error of a carriage",
                ));
            };
            if (error >= 3) != turns {
                return Err(wrong(
                    "write um, mm or nm for a translation, urad or arcsec for a rotation",
                ));
            }
            if table {
                if !["", "up", "down"].contains(&parts[2]) {
                    return Err(wrong("write the direction up or down, or nothing for both"));
                }
                let row = (number(1)?, number(3)? * unit, parts[2].to_string());
                rows[carriage][error].push(row);
            } else {
                let sine = |first: usize| -> Result<[f64; 3], String> {
                    Ok([
                        number(first)? * unit,
                        number(first + 1)?,
                        number(first + 2)?,
                    ])
                };
                let sines = [sine(4)?, sine(7)?];
                let form = Function::Form(number(2)? * unit, number(3)? * unit, sines);
                if forms[carriage][error].replace(form).is_some() {
                    return Err(wrong("remove one: this error is there twice"));
                }
            }
        }
        let missing = |what: String| format!("{what} is missing; write 0 if it has no error");
        let mut functions = core::array::from_fn(|_| {
            core::array::from_fn(|_| Function::Form(0.0, 0.0, [[0.0; 3]; 2]))
        });
        for (carriage, functions) in functions.iter_mut().enumerate() {
            let functions: &mut [Function; 6] = functions;
            for (error, function) in functions.iter_mut().enumerate() {
                let name = format!(
                    "E{}{}",
                    &"XYZABC"[error..=error],
                    &"XYZ"[carriage..=carriage]
                );
                *function = if table {
                    table_of(&name, &rows[carriage][error])?
                } else {
                    forms[carriage][error].take().ok_or_else(|| missing(name))?
                };
            }
        }
        let [c0y, b0z, a0z] = squareness;
        let given = |value: Option<f64>, name: &str| value.ok_or_else(|| missing(name.into()));
        Ok(Some(Self {
            functions,
            squareness: [
                given(c0y, "EC0Y")?,
                given(b0z, "EB0Z")?,
                given(a0z, "EA0Z")?,
            ],
            model,
            middle: [0.0; 3],
            side: [1.0; 3],
        }))
    }

    /// Error of the tool relative to the workpiece with the carriages here, mm; keeps track of
    /// their directions. A reversal takes up the lost motion of the carriage, in which the tool
    /// stands still: the difference of its positioning error between the directions.
    pub fn follow(&mut self, carriages: Vector) -> Vector {
        for (axis, carriage) in carriages.into_iter().enumerate() {
            let half = 0.5 * self.lost_motion(axis, carriage).max(REVERSAL);
            let ahead = (carriage - self.middle[axis]).clamp(-half, half);
            self.middle[axis] = carriage - ahead;
            self.side[axis] = ahead / half;
        }
        let [x, y, z] = [0, 1, 2].map(|axis| self.carriage(axis, carriages[axis]));
        match self.model {
            ErrorModel::Physical => self.physical(carriages, &x, &y, &z),
            ErrorModel::Thesis => thesis(carriages, &x, &y, &z),
        }
    }

    /// Errors of a carriage at its place, as an instrument on it sees them: translations along x,
    /// y, z in mm, then rotations about them in radians.
    #[must_use]
    pub fn of_carriage(&mut self, axis: usize, at: f64, upwards: bool) -> [f64; 6] {
        self.side[axis] = if upwards { 1.0 } else { -1.0 };
        let Carriage { by, turn } = self.carriage(axis, at);
        let ([x, y, z], [a, b, c]) = (by, turn);
        [x, y, z, a, b, c]
    }

    /// Lost motion of a carriage, mm.
    fn lost_motion(&self, axis: usize, at: f64) -> f64 {
        match &self.functions[axis][axis] {
            Function::Form(..) => 0.0,
            Function::Table(nodes, up, down) => between(nodes, down, at) - between(nodes, up, at),
        }
    }

    /// Displacement and turn of a carriage.
    fn carriage(&self, axis: usize, at: f64) -> Carriage {
        let values: [f64; 6] = core::array::from_fn(|error| match &self.functions[axis][error] {
            Function::Form(value, slope, sines) => {
                let sine = |[amplitude, wavelength, phase]: &[f64; 3]| {
                    if *wavelength == 0.0 {
                        0.0
                    } else {
                        amplitude * libm::sin(TAU * at / wavelength + phase)
                    }
                };
                value + slope * at + sines.iter().map(sine).sum::<f64>()
            }
            Function::Table(nodes, up, down) => {
                let weight = 0.5 + 0.5 * self.side[axis];
                weight * between(nodes, up, at) + (1.0 - weight) * between(nodes, down, at)
            }
        });
        let [x, y, z, a, b, c] = values;
        Carriage {
            by: [x, y, z],
            turn: [a, b, c],
        }
    }

    /// The tool in the frame of the work, less where it should be.
    fn physical(&self, [sx, sy, sz]: Vector, x: &Carriage, y: &Carriage, z: &Carriage) -> Vector {
        let [c0y, b0z, a0z] = self.squareness;
        // From the tip outwards: the z carriage turns about the tip, as its errors were measured
        // there; the x carriage about the tip at z = 0.
        let tip = z.moved([0.0; 3]);
        let tip = plus(tip, [b0z * sz, -a0z * sz, sz]);
        let tip = plus(x.moved(tip), [sx, 0.0, 0.0]);
        // The table moves by -y, along a direction that is not square to x.
        let seen = plus(tip, [-c0y * sy, sy, 0.0]);
        // In the frame of a table that is displaced by the opposite of its errors, the tool is
        // displaced by them.
        let seen = y.moved(seen);
        [seen[0] - sx, seen[1] - sy, seen[2] - sz]
    }
}

/// (3.7) and (3.15) of the thesis, as frames.
fn thesis(point: Vector, x: &Carriage, y: &Carriage, z: &Carriage) -> Vector {
    let work = y.moved_linear(point);
    let tool = plus(z.moved_linear(point), THESIS_TOOL);
    let tool = x.moved_linear(tool);
    let ideal = plus(point, THESIS_TOOL);
    core::array::from_fn(|axis| work[axis] - point[axis] + tool[axis] - ideal[axis])
}

/// Displacement and turn of a carriage by its errors.
#[derive(Debug, Clone, Copy)]
struct Carriage {
    by: Vector,
    turn: Vector,
}

impl Carriage {
    /// A point of the carriage, turned about its origin by a rotation vector and then displaced.
    fn moved(&self, point: Vector) -> Vector {
        let angle = libm::sqrt(self.turn.iter().map(|part| part * part).sum());
        let (first, second) = if angle < 1e-12 {
            (1.0, 0.5)
        } else {
            let half = libm::sin(0.5 * angle) / angle;
            (libm::sin(angle) / angle, 2.0 * half * half)
        };
        let once = cross(self.turn, point);
        let twice = cross(self.turn, once);
        core::array::from_fn(|axis| {
            point[axis] + first * once[axis] + second * twice[axis] + self.by[axis]
        })
    }

    /// The same with the matrix of small angles that the thesis uses.
    fn moved_linear(&self, point: Vector) -> Vector {
        plus(plus(point, cross(self.turn, point)), self.by)
    }
}

/// Linear between nodes, constant beyond them.
fn between(nodes: &[f64], values: &[f64], at: f64) -> f64 {
    let last = nodes.len() - 1;
    if at <= nodes[0] {
        return values[0];
    }
    if at >= nodes[last] {
        return values[last];
    }
    let upper = nodes.partition_point(|node| *node <= at);
    let part = (at - nodes[upper - 1]) / (nodes[upper] - nodes[upper - 1]);
    (1.0 - part) * values[upper - 1] + part * values[upper]
}

/// The table of a function from its lines.
fn table_of(name: &str, rows: &[(f64, f64, String)]) -> Result<Function, String> {
    let column = |direction: &str| {
        let rows = rows.iter().filter(|row| row.2 == direction);
        rows.map(|row| (row.0, row.1))
            .unzip::<_, _, Vec<f64>, Vec<f64>>()
    };
    let (both, up, down) = (column(""), column("up"), column("down"));
    let function = if !both.0.is_empty() && up.0.is_empty() && down.0.is_empty() {
        Function::Table(both.0, both.1.clone(), both.1)
    } else if both.0.is_empty() && up.0 == down.0 {
        Function::Table(up.0, up.1, down.1)
    } else {
        return Err(format!(
            "{name} needs the same positions in both directions; measure both at the same targets"
        ));
    };
    if let Function::Table(nodes, ..) = &function {
        if nodes.len() < 2 {
            return Err(format!(
                "{name} needs at least two positions; write both ends of the travel"
            ));
        }
        if nodes.windows(2).any(|pair| pair[0] >= pair[1]) {
            return Err(format!(
                "{name} has positions that do not ascend; sort them"
            ));
        }
    }
    Ok(function)
}
