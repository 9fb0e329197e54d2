//! Reader of ASCII DXF: group codes, sections, layers, blocks.
//!
//! The general DXF library of the ecosystem skips unknown entity kinds and reports no line numbers,
//! so an engraving could miss a part of the drawing without a word. This reader keeps the
//! line, handle and layer of every entity and reports each kind that it leaves out.

mod codepage;
mod entity;
mod mtext;
mod pairs;
mod placing;
mod record;
mod tables;
mod text;
mod units;

use super::ReadOptions;
use crate::drawing::{Drawing, Entity, Problem};
use crate::geometry::Point;
use codepage::decode;
use kurbo::Affine;
use pairs::{DAMAGED, Pair, Pairs};
use record::{Read, Record};
use std::collections::{BTreeMap, HashMap, HashSet};
use tables::Layer;

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

/// Entities that a notice is about: the first ones, and how many there are.
#[derive(Default)]
struct Named {
    count: usize,
    shown: Vec<Entity>,
}

impl Named {
    /// Entities that a notice names.
    const SHOWN: usize = 3;

    fn add(&mut self, entity: &Entity) {
        self.count += 1;
        if self.shown.len() < Self::SHOWN {
            self.shown.push(entity.clone());
        }
    }

    fn text(&self) -> String {
        let shown: Vec<String> = self.shown.iter().map(ToString::to_string).collect();
        let more = match self.count - shown.len() {
            0 => String::new(),
            count => format!("; and {count} more"),
        };
        format!("{}{more}", shown.join("; "))
    }
}

#[derive(Default)]
struct DrawingBlock<'a> {
    base: Point,
    items: Vec<Item<'a>>,
}

/// Note on entities with a height.
const FLATTENED: &str = "with a Z other than 0, their projection on the plane is cut";

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
    left_out: BTreeMap<String, Named>,
    /// Entities that are drawn in another way than they ask for.
    changed: BTreeMap<String, Named>,
    /// Entities placed so far, with those that draw nothing.
    placed: usize,
    /// Lines and layers of problems that are reported.
    reported: HashSet<(usize, String)>,
    /// Names and layers of blocks that are reported because they contain themselves.
    endless: HashSet<(String, String)>,
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
        placed: 0,
        reported: HashSet::new(),
        endless: HashSet::new(),
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

    /// Notes that an entity is left out.
    fn leave_out(&mut self, reason: &str, entity: &Entity) {
        self.left_out.entry(reason.into()).or_default().add(entity);
    }

    /// Notes that an entity is drawn in another way than it asks for.
    fn change(&mut self, how: &str, entity: &Entity) {
        self.changed.entry(how.into()).or_default().add(entity);
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
            self.leave_out("it is in paper space", &entity);
            self.skip_parts(kind, pairs)?;
            return Ok(None);
        }
        if kind == "SEQEND" {
            return Ok(None);
        }
        let mut is_high = record.has_height();
        let read = if kind == "POLYLINE" {
            let head: Vec<Pair> = pairs.clone();
            let mut vertices = Vec::new();
            self.parts("VERTEX", pairs, &mut vertices)?;
            let head = Record {
                kind,
                line,
                pairs: &head,
            };
            let read = entity::polyline(&head, &vertices, self.tolerance(Affine::IDENTITY));
            is_high |= matches!(read, Ok(Read::Shapes(_)))
                && vertices.iter().any(|(line, pairs)| {
                    let (kind, line) = ("VERTEX", *line);
                    Record { kind, line, pairs }.has_height()
                });
            read
        } else {
            entity::read(&record, self.options, self.tolerance(Affine::IDENTITY))
        };
        if is_high {
            self.change(FLATTENED, &entity);
        }
        Ok(Some(Item {
            entity,
            hidden,
            linetype,
            read: read.unwrap_or_else(Read::Refused),
            curve: None,
        }))
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

    fn finish(mut self) -> Result<Drawing, Problem> {
        let scale = self.millimetres()?;
        self.check_clips();
        self.note_unit();
        let drawing = &mut self.drawing;
        let hidden = self.layers.iter().filter(|(_, layer)| layer.hidden);
        drawing
            .hidden_layers
            .extend(hidden.map(|(name, _)| name.clone()));
        let left_out = self.left_out.iter();
        let left_out = left_out.map(|(reason, all)| (format!("left out, {reason}"), all));
        let changed = self.changed.iter().map(|(note, all)| (note.clone(), all));
        for (what, entities) in left_out.chain(changed) {
            let entities = entities.text();
            drawing.notices.push(format!("{what}: {entities}"));
        }
        if scale != 1.0 {
            drawing.transform(Affine::scale(scale));
        }
        Ok(self.drawing)
    }
}
