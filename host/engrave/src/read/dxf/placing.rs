//! Placing of entities in the drawing: maps of block references, layers, and what is left out.

use super::entity;
use super::record::{Insert, Read, Record};
use super::{Item, Reader};
use crate::curves::{map_path, map_point};
use crate::drawing::{Entity, Problem, short};
use crate::geometry::{Path, Point};
use crate::read::{COORDINATE_LIMIT, ENTITY_LIMIT, FAR_REMEDY};
use kurbo::Affine;

/// Deepest nesting of blocks.
const DEPTH: usize = 16;

/// An entity with the innermost and the outermost of the blocks in which it is.
fn without_chain(entity: &Entity) -> Entity {
    let mut parts = entity.kind.split(" (in ");
    let (kind, blocks): (_, Vec<&str>) = (parts.next().unwrap_or_default(), parts.collect());
    let kind = match blocks.as_slice() {
        [first, .., last] => format!(
            "{kind} (in {first}, in {} more, in {})",
            blocks.len() - 2,
            last.trim_end_matches(')')
        ),
        _ => entity.kind.clone(),
    };
    Entity {
        kind,
        ..entity.clone()
    }
}

fn too_far(entity: &Entity, at: Point) -> Problem {
    let what = format!(
        "the point {}, {} is farther than {COORDINATE_LIMIT} from the origin",
        short(at[0]),
        short(at[1])
    );
    Problem::of(entity, what, FAR_REMEDY)
}

impl<'a> Reader<'a, '_> {
    /// Adds an entity to the drawing under a map; `outer` is the entity of the block reference.
    pub(super) fn place(
        &mut self,
        item: &Item<'a>,
        map: Affine,
        outer: Option<&Entity>,
        names: &mut Vec<String>,
    ) -> Result<(), Problem> {
        // Blocks within blocks can multiply: the copies are counted, also those of nothing.
        self.placed += 1;
        if self.placed > ENTITY_LIMIT {
            return Err(Problem::general(
                format!("the drawing has more than {ENTITY_LIMIT} entities"),
                "split the drawing",
            ));
        }
        let mut entity = item.entity.clone();
        if let Some(outer) = outer {
            // An entity of a block on layer 0 is on the layer of its reference.
            if entity.layer == "0" {
                entity.layer.clone_from(&outer.layer);
            }
            entity.kind = format!("{} (in {})", entity.kind, outer.kind);
        }
        let layer = self.layers.get(&entity.layer.to_uppercase());
        let linetype = item.linetype.as_ref();
        let linetype = linetype.or(layer.and_then(|layer| layer.linetype.as_ref()));
        let is_dashed = linetype.is_some_and(|name| self.is_dashed(name));
        let is_shown = layer.is_none_or(|layer| !layer.hidden);
        if item.hidden || !is_shown {
            self.leave_out("it is invisible, or its layer is off or frozen", &entity);
            // The names of hidden layers are added at the end.
            if is_shown && !self.drawing.hidden_layers.contains(&entity.layer) {
                self.drawing.hidden_layers.push(entity.layer);
            }
            return Ok(());
        }
        // The entities of a block have layers of their own.
        let is_reference = matches!(item.read, Read::Insert(_));
        if !is_reference && let Some(reason) = self.unplotted(&entity.layer) {
            if !self.drawing.hidden_layers.contains(&entity.layer) {
                self.drawing.hidden_layers.push(entity.layer.clone());
            }
            self.leave_out(reason, &entity);
            return Ok(());
        }
        let fitted = match (&item.read, &item.curve) {
            (Read::Shapes(_), Some(pairs)) => {
                let (kind, line) = (item.entity.kind.as_str(), item.entity.line);
                let record = Record { kind, line, pairs };
                entity::read(&record, self.options, self.tolerance(map)).ok()
            }
            _ => None,
        };
        match fitted.as_ref().unwrap_or(&item.read) {
            Read::Refused(problem) => self.report(problem, &entity),
            Read::LeftOut(reason) => {
                self.leave_out(reason, &entity);
            }
            Read::Shapes(shapes) => {
                let is_text = matches!(item.entity.kind.as_str(), "TEXT" | "MTEXT" | "ATTRIB");
                let notes = shapes.notes.iter().map(|note| match is_text {
                    true => format!("text with {note}"),
                    false => (*note).into(),
                });
                // The outlines of a text have no dashes.
                let dashed = (is_dashed && !is_text && !shapes.paths.is_empty())
                    .then(|| "dashed lines are cut whole".to_string());
                for note in notes.chain(dashed) {
                    self.change(&note, &entity);
                }
                let tolerance = self.tolerance(Affine::IDENTITY);
                let placed = |path: &Path| match map == Affine::IDENTITY {
                    true => path.clone(),
                    false => map_path(map, path, tolerance),
                };
                let mut paths: Vec<Path> = shapes.paths.iter().map(placed).collect();
                let points = shapes.points.iter().map(|&at| map_point(map, at));
                let points: Vec<Point> = points.collect();
                let vertices = paths.iter().flat_map(|path| &path.vertices);
                let mut all = vertices
                    .map(|vertex| vertex.at)
                    .chain(points.iter().copied());
                let is_far = |at: &Point| at.iter().any(|value| value.abs() > COORDINATE_LIMIT);
                if !self.options.moved
                    && let Some(at) = all.find(is_far)
                {
                    self.report(&too_far(&entity, at), &entity);
                    return Ok(());
                }
                let index = self.drawing.add_entity(entity);
                for path in &mut paths {
                    path.entity = index;
                }
                self.drawing.paths.append(&mut paths);
                let points = points.into_iter().map(|at| (at, index));
                self.drawing.points.extend(points);
            }
            Read::Insert(insert) => self.insert(insert, &entity, map, names)?,
        }
        Ok(())
    }

    fn insert(
        &mut self,
        insert: &Insert,
        entity: &Entity,
        map: Affine,
        names: &mut Vec<String>,
    ) -> Result<(), Problem> {
        let name = insert.block.to_uppercase();
        if names.contains(&name) || names.len() >= DEPTH {
            // The reference is met once for each way that leads to it.
            if self.endless.insert((name, entity.layer.clone())) {
                self.drawing.problems.push(Problem::of(
                    &without_chain(entity),
                    format!(
                        "block {} contains itself or is nested deeper than {DEPTH} blocks",
                        insert.block
                    ),
                    "explode the block in the drawing program",
                ));
            }
            return Ok(());
        }
        // The block leaves the table while its entities are placed.
        let Some(block) = self.blocks.remove(&name) else {
            self.drawing.problems.push(Problem::of(
                entity,
                format!("the file has no block {}", insert.block),
                "bind external references, or explode the block in the drawing program",
            ));
            return Ok(());
        };
        names.push(name.clone());
        let mut outer = entity.clone();
        outer.kind = entity
            .kind
            .replacen("INSERT", &format!("INSERT {}", insert.block), 1);
        if let Some(handle) = &entity.handle {
            outer.kind = format!("{} handle {handle}", outer.kind);
        }
        let base = Affine::translate((-block.base[0], -block.base[1]));
        let mut result = Ok(());
        'copies: for copy in &insert.maps {
            for item in &block.items {
                result = self.place(item, map * *copy * base, Some(&outer), names);
                if result.is_err() {
                    break 'copies;
                }
            }
        }
        names.pop();
        self.blocks.insert(name, block);
        result
    }

    /// Reports a problem of an entity once on each layer.
    fn report(&mut self, problem: &Problem, entity: &Entity) {
        if self.reported.insert((problem.line, entity.layer.clone())) {
            let mut problem = problem.clone();
            problem.layer = Some(entity.layer.clone());
            self.drawing.problems.push(problem);
        }
    }
}
