//! Reader of ASCII DXF: group codes, sections, layers, blocks.
//!
//! The general DXF library of the ecosystem skips unknown entity kinds and reports no line numbers,
//! so an engraving could miss a part of the drawing without a word. This reader keeps the
//! line, handle and layer of every entity and reports each kind that it leaves out.

use super::dxf_codepage::decode;
use super::dxf_entity;
use super::dxf_pairs::{DAMAGED, Pair, Pairs};
use super::dxf_record::{Insert, Read, Record};
use super::{ENTITY_LIMIT, ReadOptions};
use crate::curves::{TOLERANCE, map_path, map_point};
use crate::drawing::{Drawing, Entity, Problem};
use crate::geometry::Point;
use kurbo::Affine;
use std::collections::{BTreeMap, HashMap, HashSet};

/// Deepest nesting of blocks.
const DEPTH: usize = 16;

/// A layer of the tables.
#[derive(Default, Clone)]
struct Layer {
    hidden: bool,
    linetype: Option<String>,
}

/// An entity with what it draws.
struct Item<'a> {
    entity: Entity,
    hidden: bool,
    /// Its linetype in capitals; `None` is that of its layer.
    linetype: Option<String>,
    read: Read,
    /// The pairs of a curve in a block: it is read again at the size of each reference, so that
    /// its arcs deviate by no more than the tolerance there.
    curve: Option<Vec<Pair<'a>>>,
}

#[derive(Default)]
struct DrawingBlock<'a> {
    base: Point,
    items: Vec<Item<'a>>,
}

struct Reader<'a, 'o> {
    pairs: Pairs<'a>,
    options: &'o ReadOptions<'o>,
    layers: HashMap<String, Layer>,
    /// Names of the linetypes of the tables in capitals, and whether they have dashes.
    linetypes: HashMap<String, bool>,
    /// Objects that clip a block reference, and their dictionaries: handle and owner.
    clips: Vec<String>,
    owners: HashMap<String, String>,
    blocks: HashMap<String, DrawingBlock<'a>>,
    unit: Option<i64>,
    metric: Option<i64>,
    drawing: Drawing,
    left_out: BTreeMap<String, Vec<Entity>>,
    /// Entities that are drawn in another way than they ask for.
    changed: BTreeMap<String, Vec<Entity>>,
    hidden: usize,
    paper: usize,
    /// Whether the file stated Z coordinates other than 0.
    flattened: usize,
    /// Entities placed so far, with those that draw nothing.
    placed: usize,
    /// Lines and layers of problems that are reported.
    reported: HashSet<(usize, String)>,
}

/// Reads a DXF drawing.
pub fn read(bytes: &[u8], options: &ReadOptions) -> Result<Drawing, Problem> {
    let decoded = decode(bytes);
    let mut reader = Reader {
        pairs: Pairs::new(&decoded.bytes),
        options,
        layers: HashMap::new(),
        linetypes: HashMap::new(),
        clips: Vec::new(),
        owners: HashMap::new(),
        blocks: HashMap::new(),
        unit: None,
        metric: None,
        drawing: Drawing::default(),
        left_out: BTreeMap::new(),
        changed: BTreeMap::new(),
        hidden: 0,
        paper: 0,
        flattened: 0,
        placed: 0,
        reported: HashSet::new(),
    };
    reader.drawing.notices.extend(decoded.notice);
    reader.file()?;
    reader.finish()
}

impl<'a> Reader<'a, '_> {
    fn file(&mut self) -> Result<(), Problem> {
        let mut record = Vec::new();
        let mut sections = 0;
        while let Some(pair) = self.pairs.next()? {
            match (pair.code, pair.word()) {
                (0, "SECTION") => {
                    sections += 1;
                    let name = self.pairs.next()?.filter(|pair| pair.code == 2);
                    let Some(name) = name else {
                        return Err(Problem::at_line(
                            pair.line,
                            "a section has no name",
                            DAMAGED,
                        ));
                    };
                    self.section(name.word(), &mut record)?;
                }
                (0, "EOF") => return self.sections(sections),
                // Old versions of dxflib close the header after its second variable.
                (9, _) => {
                    self.drawing.notices.push(
                        "variables of the header are outside of a section; they are used".into(),
                    );
                    self.pairs.back = Some(pair);
                    self.header(pair.line)?;
                }
                (code, word) => {
                    let what = format!("group {code} with '{word}' is outside of a section");
                    return Err(Problem::at_line(pair.line, what, DAMAGED));
                }
            }
        }
        self.drawing
            .notices
            .push("the file has no EOF; all of its sections are complete".into());
        self.sections(sections)
    }

    fn sections(&self, sections: usize) -> Result<(), Problem> {
        if sections == 0 {
            return Err(Problem::general(
                "the file is neither a DXF nor an SVG",
                "pass an ASCII DXF or an SVG drawing",
            ));
        }
        Ok(())
    }

    fn section(&mut self, name: &str, record: &mut Vec<Pair<'a>>) -> Result<(), Problem> {
        let begin = self.pairs.line;
        if name == "HEADER" {
            return self.header(begin);
        }
        let mut block: Option<(String, DrawingBlock<'a>)> = None;
        while let Some(pair) = self.pairs.next()? {
            if pair.code != 0 {
                if name == "ENTITIES" || name == "BLOCKS" {
                    let what = format!("group {} is before the first entity", pair.code);
                    return Err(Problem::at_line(pair.line, what, DAMAGED));
                }
                continue;
            }
            let kind = pair.word();
            if kind == "ENDSEC" {
                return Ok(());
            }
            if kind == "EOF" || kind == "SECTION" {
                break;
            }
            self.pairs.rest_of_record(record)?;
            match (name, kind) {
                ("TABLES", "LAYER") => self.layer(record),
                ("TABLES", "LTYPE") => self.linetype(record),
                ("OBJECTS", "DICTIONARY" | "SPATIAL_FILTER") => self.object(kind, record),
                ("BLOCKS", "BLOCK") => {
                    let value = |code| record.iter().find(|pair| pair.code == code);
                    let number = |code| {
                        value(code)
                            .and_then(|pair| pair.word().parse().ok())
                            .unwrap_or(0.0)
                    };
                    let name = value(2).map_or_else(String::new, |pair| pair.text().trim().into());
                    let base = [number(10), number(20)];
                    block = Some((
                        name.to_uppercase(),
                        DrawingBlock {
                            base,
                            items: Vec::new(),
                        },
                    ));
                }
                ("BLOCKS", "ENDBLK") => {
                    if let Some((name, block)) = block.take() {
                        self.blocks.insert(name, block);
                    }
                }
                ("BLOCKS", _) => {
                    let curve = matches!(kind, "ELLIPSE" | "SPLINE" | "TEXT" | "MTEXT" | "ATTRIB");
                    let pairs = curve.then(|| record.clone());
                    if let Some(mut item) = self.entity(kind, pair.line, record)?
                        && let Some((_, block)) = &mut block
                    {
                        item.curve = pairs;
                        block.items.push(item);
                    }
                }
                ("ENTITIES", _) => {
                    if let Some(mut item) = self.entity(kind, pair.line, record)? {
                        if kind == "ATTDEF" {
                            let what = "ATTDEF is text only where its block is inserted";
                            item.read = Read::LeftOut(what.into());
                        }
                        self.place(&item, Affine::IDENTITY, None, &mut Vec::new())?;
                    }
                }
                _ => {}
            }
        }
        Err(Problem::at_line(
            self.pairs.line,
            format!("the file ends inside section {name}, which begins at line {begin}"),
            "the file is truncated; save or copy the drawing again",
        ))
    }

    fn header(&mut self, begin: usize) -> Result<(), Problem> {
        let mut variable = "";
        while let Some(pair) = self.pairs.next()? {
            match (pair.code, variable) {
                (0, _) if pair.word() == "ENDSEC" => return Ok(()),
                (9, _) => variable = pair.word(),
                (70, "$INSUNITS") => self.unit = pair.word().parse().ok(),
                (70, "$MEASUREMENT") => self.metric = pair.word().parse().ok(),
                _ => {}
            }
        }
        Err(Problem::at_line(
            self.pairs.line,
            format!("the file ends inside section HEADER, which begins at line {begin}"),
            "the file is truncated; save or copy the drawing again",
        ))
    }

    fn layer(&mut self, record: &[Pair]) {
        let value = |code| record.iter().find(|pair| pair.code == code);
        let number = |code| value(code).and_then(|pair| pair.word().parse::<i64>().ok());
        if let Some(name) = value(2) {
            let hidden = number(62).is_some_and(|colour| colour < 0)
                || number(70).is_some_and(|flags| flags & 1 != 0);
            let linetype = value(6).map(|pair| pair.text().trim().to_uppercase());
            let name = name.text().trim().to_uppercase();
            self.layers.insert(name, Layer { hidden, linetype });
        }
    }

    fn linetype(&mut self, record: &[Pair]) {
        let value = |code| record.iter().find(|pair| pair.code == code);
        if let Some(name) = value(2) {
            // The number of dashes and gaps.
            let parts = value(73).and_then(|pair| pair.word().parse::<i64>().ok());
            let name = name.text().trim().to_uppercase();
            self.linetypes.insert(name, parts.unwrap_or(0) > 0);
        }
    }

    /// Notes the owner of a dictionary or of a clip (XCLIP) that is switched on.
    fn object(&mut self, kind: &str, record: &[Pair]) {
        let value = |code| record.iter().find(|pair| pair.code == code);
        let Some(handle) = value(5).map(|pair| pair.word().to_uppercase()) else {
            return;
        };
        // The last of the pointers before the first subclass is the owner.
        let head = record.iter().take_while(|pair| pair.code != 100);
        let owner = head.filter(|pair| pair.code == 330).last();
        if let Some(owner) = owner {
            let owner = owner.word().to_uppercase();
            self.owners.insert(handle.clone(), owner);
        }
        if kind == "SPATIAL_FILTER" && value(71).is_none_or(|pair| pair.word() != "0") {
            self.clips.push(handle);
        }
    }

    /// Whether a linetype has dashes. One that the tables do not have is no plain line, if it is
    /// not named as one.
    fn is_dashed(&self, name: &str) -> bool {
        !matches!(name, "" | "CONTINUOUS" | "BYLAYER" | "BYBLOCK")
            && self.linetypes.get(name).copied().unwrap_or(true)
    }

    /// Refuses clipped block references, which would be cut whole, or notes them.
    fn check_clips(&mut self) {
        for clip in std::mem::take(&mut self.clips) {
            // The clip is in a dictionary of the dictionary of the reference.
            let mut handle = Some(&clip);
            for _ in 0..3 {
                handle = handle.and_then(|handle| self.owners.get(handle));
            }
            let reference = match handle {
                Some(handle) => format!("INSERT handle {handle}"),
                None => format!("the reference of SPATIAL_FILTER handle {clip}"),
            };
            if self.options.ignore_clips {
                let notice = format!("cut whole, without its clip (XCLIP): {reference}");
                self.drawing.notices.push(notice);
                continue;
            }
            self.drawing.problems.push(Problem::general(
                format!("{reference}: its clip (XCLIP) hides a part of it, which would be cut"),
                "explode and trim the block in the drawing program, or cut it whole with \
                 --ignore-clips",
            ));
        }
    }

    /// Reads one entity; `None` for parts of others that are read with them.
    fn entity(
        &mut self,
        kind: &str,
        line: usize,
        pairs: &mut Vec<Pair<'a>>,
    ) -> Result<Option<Item<'a>>, Problem> {
        let record = Record { kind, line, pairs };
        let entity = record.entity();
        let flag = |code, bit| matches!(record.integer(code), Ok(Some(value)) if value & bit != 0);
        let hidden = flag(60, 1) || kind == "ATTRIB" && flag(70, 1);
        let linetype = record
            .value(6)
            .map(|pair| pair.text().trim().to_uppercase())
            .filter(|name| name != "BYLAYER");
        if record.integer(67).is_ok_and(|value| value == Some(1)) {
            self.paper += 1;
            self.skip_parts(kind, pairs)?;
            return Ok(None);
        }
        if kind == "SEQEND" || kind == "VERTEX" {
            return Ok(None);
        }
        if record.has_height() {
            self.flattened += 1;
        }
        let read = if kind == "POLYLINE" {
            let head: Vec<Pair> = pairs.clone();
            let mut vertices = Vec::new();
            self.parts("VERTEX", pairs, &mut vertices)?;
            let head = Record {
                kind,
                line,
                pairs: &head,
            };
            dxf_entity::polyline(&head, &vertices)
        } else {
            dxf_entity::read(&record, self.options, self.tolerance(Affine::IDENTITY))
        };
        Ok(Some(Item {
            entity,
            hidden,
            linetype,
            read: read.unwrap_or_else(Read::Refused),
            curve: None,
        }))
    }

    /// Tolerance of curves in the units of an entity that is placed by a map.
    fn tolerance(&self, map: Affine) -> f64 {
        let [a, b, c, d, ..] = map.as_coeffs();
        let size = a.hypot(b).max(c.hypot(d)) * self.millimetres().unwrap_or(1.0);
        TOLERANCE / size
    }

    /// Reports a problem of an entity once on each layer.
    fn report(&mut self, problem: &Problem, entity: &Entity) {
        if self.reported.insert((problem.line, entity.layer.clone())) {
            let mut problem = problem.clone();
            problem.layer = Some(entity.layer.clone());
            self.drawing.problems.push(problem);
        }
    }

    /// Reads the records of this kind up to SEQEND.
    fn parts(
        &mut self,
        kind: &str,
        pairs: &mut Vec<Pair<'a>>,
        parts: &mut Vec<(usize, Vec<Pair<'a>>)>,
    ) -> Result<(), Problem> {
        while let Some(pair) = self.pairs.next()? {
            let word = pair.word();
            if word != kind && word != "SEQEND" {
                self.pairs.back = Some(pair);
                return Ok(());
            }
            self.pairs.rest_of_record(pairs)?;
            if word == "SEQEND" {
                return Ok(());
            }
            parts.push((pair.line, pairs.clone()));
        }
        Ok(())
    }

    fn skip_parts(&mut self, kind: &str, pairs: &mut Vec<Pair<'a>>) -> Result<(), Problem> {
        if kind == "POLYLINE" {
            self.parts("VERTEX", pairs, &mut Vec::new())?;
        }
        Ok(())
    }

    /// Adds an entity to the drawing under a map; `outer` is the entity of the block reference.
    fn place(
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
        if item.hidden || layer.is_some_and(|layer| layer.hidden) {
            self.hidden += 1;
            return Ok(());
        }
        let fitted = match (&item.read, &item.curve) {
            (Read::Shapes(_), Some(pairs)) => {
                let (kind, line) = (item.entity.kind.as_str(), item.entity.line);
                let record = Record { kind, line, pairs };
                dxf_entity::read(&record, self.options, self.tolerance(map)).ok()
            }
            _ => None,
        };
        match fitted.as_ref().unwrap_or(&item.read) {
            Read::Refused(problem) => self.report(problem, &entity),
            Read::LeftOut(reason) => {
                self.left_out
                    .entry(reason.clone())
                    .or_default()
                    .push(entity);
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
                    self.changed.entry(note).or_default().push(entity.clone());
                }
                let index = self.drawing.add_entity(entity);
                let tolerance = self.tolerance(Affine::IDENTITY);
                for path in &shapes.paths {
                    let mut path = if map == Affine::IDENTITY {
                        path.clone()
                    } else {
                        map_path(map, path, tolerance)
                    };
                    path.entity = index;
                    self.drawing.paths.push(path);
                }
                for &at in &shapes.points {
                    self.drawing.points.push((map_point(map, at), index));
                }
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
            self.drawing.problems.push(Problem::of(
                entity,
                format!(
                    "block {} contains itself or is nested too deep",
                    insert.block
                ),
                "explode the block in the drawing program",
            ));
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

    fn finish(mut self) -> Result<Drawing, Problem> {
        let scale = self.millimetres()?;
        self.check_clips();
        self.note_unit();
        let drawing = &mut self.drawing;
        let left_out = self.left_out.iter();
        let left_out = left_out.map(|(reason, all)| (format!("left out, {reason}"), all));
        let changed = self.changed.iter().map(|(note, all)| (note.clone(), all));
        for (what, entities) in left_out.chain(changed) {
            let shown: Vec<String> = entities.iter().take(3).map(ToString::to_string).collect();
            let more = match entities.len() {
                0..=3 => String::new(),
                count => format!("; and {} more", count - 3),
            };
            drawing
                .notices
                .push(format!("{what}: {}{more}", shown.join("; ")));
        }
        let mut count = |count: usize, what: &str| {
            if count > 0 {
                drawing.notices.push(format!("{count} entities {what}"));
            }
        };
        count(
            self.hidden,
            "left out: they are invisible, or their layer is off or frozen",
        );
        count(self.paper, "left out: they are in paper space");
        count(
            self.flattened,
            "have a Z other than 0: their projection on the plane is used",
        );
        if scale != 1.0 {
            drawing.transform(Affine::scale(scale));
        }
        Ok(self.drawing)
    }

    /// Whether the unit is inches by the measurement only.
    fn english(&self) -> bool {
        matches!((self.unit, self.metric), (None | Some(0), Some(0)))
    }

    /// Millimetres per unit, with the factor of the caller.
    fn millimetres(&self) -> Result<f64, Problem> {
        let unit = match (self.options.unit_mm, self.unit) {
            (Some(unit), _) => unit,
            (None, None | Some(0)) if self.english() => 25.4,
            (None, None | Some(0)) => 1.0,
            (None, Some(unit)) => millimetres_of(unit).ok_or_else(|| {
                Problem::general(
                    format!("the drawing's unit ($INSUNITS) is {unit}, which is not known"),
                    "state the unit with --unit mm or --unit inch",
                )
            })?,
        };
        Ok(unit * self.options.scale.unwrap_or(1.0))
    }

    /// Tells which unit is taken where the file states none.
    fn note_unit(&mut self) {
        if self.options.unit_mm.is_some() || !matches!(self.unit, None | Some(0)) {
            return;
        }
        let notice = if self.english() {
            "the drawing states no unit, but English measurement: 1 unit is taken as 1 inch; \
             --unit mm sets millimetres"
        } else {
            "the drawing states no unit ($INSUNITS): 1 unit is taken as 1 mm; --unit inch sets \
             inches"
        };
        self.drawing.notices.push(notice.into());
    }
}

/// Millimetres per unit of a value of `$INSUNITS`.
fn millimetres_of(unit: i64) -> Option<f64> {
    Some(match unit {
        1 => 25.4,
        2 => 304.8,
        3 => 1_609_344.0,
        4 => 1.0,
        5 => 10.0,
        6 => 1000.0,
        7 => 1e6,
        8 => 25.4e-6,
        9 => 25.4e-3,
        10 => 914.4,
        11 => 1e-7,
        12 => 1e-6,
        13 => 1e-3,
        14 => 100.0,
        15 => 1e4,
        16 => 1e5,
        17 => 1e12,
        18 => 1.495_978_707e14,
        19 => 9.460_730_472_580_8e18,
        20 => 3.085_677_581_491_367e19,
        // The foot of the survey of the United States is 1200/3937 m.
        21 => 1_200_000.0 / 3937.0,
        22 => 100_000.0 / 3937.0,
        23 => 3_600_000.0 / 3937.0,
        24 => 6_336_000_000.0 / 3937.0,
        _ => return None,
    })
}
