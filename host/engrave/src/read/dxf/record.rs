//! Records of a DXF drawing, and what a record draws.

use super::mtext::Notes;
use super::pairs::Pair;
use crate::drawing::{Entity, Problem, short};
use crate::geometry::{Path, Point};
use crate::read::FAR_LIMIT;
use kurbo::Affine;

/// The pairs of an entity.
pub struct Record<'p, 'a> {
    pub kind: &'p str,
    pub line: usize,
    pub pairs: &'p [Pair<'a>],
}

impl<'a> Record<'_, 'a> {
    pub fn value(&self, code: i32) -> Option<&Pair<'a>> {
        self.pairs.iter().find(|pair| pair.code == code)
    }

    pub fn entity(&self) -> Entity {
        let text = |code| self.value(code).map(|pair| pair.text().trim().to_string());
        Entity {
            kind: self.kind.to_string(),
            handle: text(5).or_else(|| text(105)),
            layer: text(8).unwrap_or_else(|| "0".into()),
            outer: Vec::new(),
            line: self.line,
        }
    }

    pub fn parse(&self, pair: &Pair) -> Result<f64, Problem> {
        let word = pair.word();
        let number = word.parse::<f64>().ok().filter(|value| value.is_finite());
        number.ok_or_else(|| {
            let what = format!(
                "group {} in line {} is '{word}' and not a finite number",
                pair.code, pair.line
            );
            Problem::of(&self.entity(), what, "repair or delete the entity")
        })
    }

    /// A number, if the code is there.
    pub fn number(&self, code: i32) -> Result<Option<f64>, Problem> {
        self.value(code).map(|pair| self.parse(pair)).transpose()
    }

    pub fn or(&self, code: i32, default: f64) -> Result<f64, Problem> {
        Ok(self.number(code)?.unwrap_or(default))
    }

    pub fn need(&self, code: i32) -> Result<f64, Problem> {
        self.number(code)?.ok_or_else(|| {
            let what = format!("group {code} is missing");
            Problem::of(&self.entity(), what, "repair or delete the entity")
        })
    }

    pub fn integer(&self, code: i32) -> Result<Option<i64>, Problem> {
        Ok(self.number(code)?.map(|value| value as i64))
    }

    /// A point with these codes for x and y.
    pub fn point(&self, x: i32, y: i32) -> Result<Point, Problem> {
        self.within([self.need(x)?, self.need(y)?])
    }

    pub fn within(&self, at: Point) -> Result<Point, Problem> {
        if at.iter().all(|value| value.abs() <= FAR_LIMIT) {
            return Ok(at);
        }
        let what = format!(
            "the point {}, {} is farther than {FAR_LIMIT:e} from the origin",
            short(at[0]),
            short(at[1])
        );
        Err(Problem::of(
            &self.entity(),
            what,
            "move the entity, or delete it",
        ))
    }

    pub fn refuse(&self, what: impl std::fmt::Display, remedy: &str) -> Problem {
        Problem::of(&self.entity(), what, remedy)
    }

    /// Whether a Z or an elevation other than 0 is stated.
    pub fn has_height(&self) -> bool {
        self.pairs.iter().any(|pair| {
            matches!(pair.code, 30 | 31 | 38)
                && pair
                    .word()
                    .parse::<f64>()
                    .is_ok_and(|value| value.abs() > 1e-9)
        })
    }

    /// Map of the entity's own plane to the drawing plane, by its extrusion direction.
    pub fn plane(&self) -> Result<Affine, Problem> {
        let normal = [self.or(210, 0.0)?, self.or(220, 0.0)?, self.or(230, 1.0)?];
        if normal[0].abs() > 1e-6 || normal[1].abs() > 1e-6 || normal[2] == 0.0 {
            return Err(self.refuse(
                "its plane is tilted against the drawing plane",
                "flatten the drawing in the drawing program",
            ));
        }
        Ok(if normal[2] < 0.0 {
            Affine::FLIP_X
        } else {
            Affine::IDENTITY
        })
    }
}

/// What an entity draws.
#[derive(Default)]
pub struct Shapes {
    pub paths: Vec<Path>,
    pub points: Vec<Point>,
    /// What the entity asks for and does not get.
    pub notes: Notes,
}

/// A reference to a block.
#[derive(Clone)]
pub struct Insert {
    pub block: String,
    /// Maps of its copies.
    pub maps: Vec<Affine>,
}

/// What a record turned out to be.
pub enum Read {
    Shapes(Shapes),
    Insert(Insert),
    /// Left out, with the reason.
    LeftOut(String),
    /// Cannot be cut.
    Refused(Problem),
}
