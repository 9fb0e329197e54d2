//! A drawing: paths with the entities they are from, and what was left out of it.

use crate::curves::{TOLERANCE, map_path, map_point};
use crate::geometry::{Path, Point};
use kurbo::Affine;
use serde::Serialize;
use std::fmt;

/// An entity of a drawing file.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
pub struct Entity {
    /// Name of its kind in the file: `LINE`, `LWPOLYLINE`, `path`, `circle`.
    pub kind: String,
    /// Handle (DXF) or id (SVG), where the file states one.
    pub handle: Option<String>,
    /// Layer; in an SVG the label of the group.
    pub layer: String,
    /// Layers that hold this layer, the outermost first (Inkscape).
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub outer: Vec<String>,
    /// Line of the file at which it begins, from 1.
    pub line: usize,
}

impl fmt::Display for Entity {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "line {}: {}", self.line, self.kind)?;
        if let Some(handle) = &self.handle {
            write!(out, " handle {handle}")?;
        }
        if !self.layer.is_empty() {
            write!(out, " on layer {}", self.layer)?;
        }
        Ok(())
    }
}

/// A mistake in a drawing, or something that the program cannot do with it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Problem {
    /// Line of the file, from 1; 0 where no single line is at fault.
    pub line: usize,
    /// What is wrong, with the entity.
    pub message: String,
    /// What to do about it.
    pub remedy: String,
    /// Layer of the entity at fault; `None` where the file as a whole is.
    pub layer: Option<String>,
    /// Layers that hold this layer.
    #[serde(skip)]
    pub outer: Vec<String>,
}

impl Problem {
    /// A problem at a line of the file.
    pub fn at_line(line: usize, message: impl fmt::Display, remedy: impl fmt::Display) -> Self {
        let message = if line == 0 {
            message.to_string()
        } else {
            format!("line {line}: {message}")
        };
        Self {
            line,
            message,
            remedy: remedy.to_string(),
            layer: None,
            outer: Vec::new(),
        }
    }

    /// A problem of an entity.
    pub fn of(entity: &Entity, message: impl fmt::Display, remedy: impl fmt::Display) -> Self {
        Self {
            line: entity.line,
            message: format!("{entity}: {message}"),
            remedy: remedy.to_string(),
            layer: Some(entity.layer.clone()),
            outer: entity.outer.clone(),
        }
    }

    /// A problem of the file or the job as a whole.
    pub fn general(message: impl fmt::Display, remedy: impl fmt::Display) -> Self {
        Self::at_line(0, message, remedy)
    }
}

impl fmt::Display for Problem {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{}; {}", self.message, self.remedy)
    }
}

impl std::error::Error for Problem {}

/// Paths of a drawing, in mm.
#[derive(Debug, Clone, Default)]
pub struct Drawing {
    /// Entities that have paths or points.
    pub entities: Vec<Entity>,
    /// Paths in the order of the file.
    pub paths: Vec<Path>,
    /// Points of the drawing (DXF POINT) with their entity.
    pub points: Vec<(Point, usize)>,
    /// Layers that are off, frozen, hidden or not plotted, or of which an entity is: they may draw
    /// nothing.
    pub hidden_layers: Vec<String>,
    /// What was left out or assumed, one sentence each.
    pub notices: Vec<String>,
    /// Mistakes that do not stop the reading, so that a person sees all of them at once.
    pub problems: Vec<Problem>,
}

/// Which layers of a drawing count.
#[derive(Debug, Clone, Default)]
pub struct LayerChoice {
    /// Only these, if there are any.
    pub only: Vec<String>,
    /// Not these.
    pub without: Vec<String>,
}

/// A number for a message: a large or tiny one with an exponent instead of hundreds of digits.
#[must_use]
pub fn short(value: f64) -> String {
    let is_tiny = value != 0.0 && value.abs() < 1e-9;
    if value.abs() < 1e9 && !is_tiny {
        value.to_string()
    } else {
        format!("{value:e}")
    }
}

/// Whether two names have the same letters, in either case.
fn is_same_name(a: &str, b: &str) -> bool {
    a.eq_ignore_ascii_case(b) || a.to_lowercase() == b.to_lowercase()
}

impl LayerChoice {
    /// Whether a layer counts, by its name or by that of a layer that holds it. Letters count in
    /// either case.
    #[must_use]
    pub fn allows(&self, layer: &str, outer: &[String]) -> bool {
        let is_one_of = |names: &[String]| {
            let mut all = outer.iter().map(String::as_str).chain([layer]);
            all.any(|layer| names.iter().any(|name| is_same_name(name, layer)))
        };
        (self.only.is_empty() || is_one_of(&self.only)) && !is_one_of(&self.without)
    }
}

impl Drawing {
    /// Appends an entity; its index is returned.
    pub fn add_entity(&mut self, entity: Entity) -> usize {
        self.entities.push(entity);
        self.entities.len() - 1
    }

    /// Entity of a path.
    #[must_use]
    pub fn entity(&self, path: &Path) -> &Entity {
        &self.entities[path.entity]
    }

    /// Centre of a path that is a full circle.
    #[must_use]
    pub fn circle_centre(&self, path: &Path) -> Option<Point> {
        let [a, b] = path.vertices.as_slice() else {
            return None;
        };
        let round = |bulge: f64| (bulge.abs() - 1.0).abs() < 1e-9;
        (path.closed && round(a.bulge) && round(b.bulge) && a.bulge * b.bulge > 0.0).then(|| {
            [
                f64::midpoint(a.at[0], b.at[0]),
                f64::midpoint(a.at[1], b.at[1]),
            ]
        })
    }

    /// Box around all paths and points.
    #[must_use]
    pub fn bounds(&self) -> Option<[Point; 2]> {
        let boxes = self.paths.iter().filter_map(Path::bounds);
        let points = self.points.iter().map(|&(at, _)| [at, at]);
        boxes.chain(points).reduce(|[low, high], [l, h]| {
            [
                [low[0].min(l[0]), low[1].min(l[1])],
                [high[0].max(h[0]), high[1].max(h[1])],
            ]
        })
    }

    /// Maps everything.
    pub fn transform(&mut self, map: Affine) {
        for path in &mut self.paths {
            *path = map_path(map, path, TOLERANCE);
        }
        for (at, _) in &mut self.points {
            *at = map_point(map, *at);
        }
    }

    /// Keeps the chosen layers, with their problems. That something is left out is noted.
    ///
    /// # Errors
    /// A chosen layer that the drawing does not have, or that shows nothing.
    pub fn select_layers(&mut self, choice: &LayerChoice) -> Result<(), Problem> {
        let of_entities = self.entities.iter().map(|one| one.layer.as_str());
        let of_problems = self.problems.iter().filter_map(|one| one.layer.as_deref());
        let outer = self.entities.iter().map(|one| &one.outer);
        let outer = outer.chain(self.problems.iter().map(|one| &one.outer));
        let outer = outer.flatten().map(String::as_str);
        let mut names: Vec<&str> = of_entities.chain(of_problems).chain(outer).collect();
        names.sort_unstable();
        names.dedup();
        let is_only = choice.only.iter().map(|one| (one, true));
        let is_without = choice.without.iter().map(|one| (one, false));
        for (requested, is_chosen) in is_only.chain(is_without) {
            if names.iter().any(|name| is_same_name(name, requested)) {
                continue;
            }
            let mut hidden = self.hidden_layers.iter();
            let is_hidden = hidden.any(|name| is_same_name(name, requested));
            if is_hidden && is_chosen {
                return Err(Problem::general(
                    format!(
                        "layer {requested} is off, frozen, hidden or not plotted: nothing of it is \
                         drawn"
                    ),
                    "switch it on, or let it plot, in the drawing program",
                ));
            }
            if !is_hidden {
                return Err(Problem::general(
                    format!("the drawing has no layer {requested}"),
                    format!("its layers are {}", names.join(", ")),
                ));
            }
        }
        let entities = &self.entities;
        let keeps = |entity: usize| choice.allows(&entities[entity].layer, &entities[entity].outer);
        self.problems.retain(|one| {
            one.layer
                .as_deref()
                .is_none_or(|layer| choice.allows(layer, &one.outer))
        });
        let before = self.paths.len() + self.points.len();
        self.paths.retain(|path| keeps(path.entity));
        self.points.retain(|&(_, entity)| keeps(entity));
        let left_out = before - self.paths.len() - self.points.len();
        if left_out > 0 {
            self.notices
                .push(format!("the choice of layers leaves out {left_out} paths"));
        }
        Ok(())
    }

    /// Joins paths whose ends meet within `tolerance` (mm) into chains, in either direction. Chains
    /// whose ends meet are closed. Where more than two ends meet, the earliest in the file join.
    pub fn chain(&mut self, tolerance: f64) {
        let paths = std::mem::take(&mut self.paths);
        self.paths = crate::chain::chain(paths, tolerance);
    }
}
