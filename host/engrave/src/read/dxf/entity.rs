//! Entities of a DXF drawing as paths.

use super::pairs::Pair;
use super::record::{Insert, Read, Record, Shapes};
use super::text;
use crate::curves::{TOLERANCE, fit_ellipse, map_path};
use crate::drawing::{Problem, short};
use crate::geometry::{Path, Point, Segment, Vertex, distance};
use crate::read::nurbs::Nurbs;
use crate::read::{ENTITY_LIMIT, ReadOptions};
use kurbo::Affine;
use std::f64::consts::TAU;

/// Largest radius of an arc, mm.
const RADIUS_LIMIT: f64 = 1e6;

/// Reads an entity, except POLYLINE, which has records of its own.
///
/// Curves become arcs within `tolerance`, in units of the drawing.
pub fn read(record: &Record, options: &ReadOptions, tolerance: f64) -> Result<Read, Problem> {
    let paths = match record.kind {
        "LINE" => {
            let (from, to) = (record.point(10, 20)?, record.point(11, 21)?);
            vec![Path::from_segments(
                &[Segment {
                    from,
                    to,
                    bulge: 0.0,
                }],
                0,
            )]
        }
        "ARC" | "CIRCLE" if record.number(40)? == Some(0.0) => {
            return Ok(Read::LeftOut("it has no length".into()));
        }
        "ARC" => vec![arc(record)?],
        "CIRCLE" => {
            let path = Path::circle(record.point(10, 20)?, radius(record)?, 0);
            vec![map_path(record.plane()?, &path, TOLERANCE)]
        }
        "LWPOLYLINE" => return light_polyline(record, tolerance),
        "ELLIPSE" if is_flat(record)? => {
            return Ok(Read::LeftOut("an axis of it has no length".into()));
        }
        "ELLIPSE" => vec![ellipse(record, tolerance)?],
        "SPLINE" => vec![spline(record, tolerance)?],
        "SOLID" | "TRACE" => vec![solid(record)?],
        "POINT" => {
            let points = vec![record.point(10, 20)?];
            return Ok(Read::Shapes(Shapes {
                points,
                ..Shapes::default()
            }));
        }
        "INSERT" => return insert(record).map(Read::Insert),
        "TEXT" | "MTEXT" | "ATTRIB" => return text::read(record, options, tolerance),
        // The text of a definition shows only where a block is inserted, as ATTRIB.
        "ATTDEF" => return Ok(Read::Shapes(Shapes::default())),
        "VERTEX" => return Ok(Read::LeftOut("VERTEX is outside of a POLYLINE".into())),
        kind => return Ok(Read::LeftOut(format!("{kind} is not a path"))),
    };
    Ok(shapes(paths))
}

/// Paths with a length; without one there is nothing to cut.
fn shapes(paths: Vec<Path>) -> Read {
    if paths.iter().all(|path| path.length() <= 1e-9) {
        return Read::LeftOut("it has no length".into());
    }
    Read::Shapes(Shapes {
        paths,
        ..Shapes::default()
    })
}

fn radius(record: &Record) -> Result<f64, Problem> {
    let radius = record.need(40)?;
    if radius > 0.0 && radius <= RADIUS_LIMIT {
        return Ok(radius);
    }
    let radius = short(radius);
    let what = format!("its radius is {radius}; it must be above 0 and at most {RADIUS_LIMIT}");
    Err(record.refuse(what, "repair or delete the entity"))
}

fn arc(record: &Record) -> Result<Path, Problem> {
    let (centre, radius) = (record.point(10, 20)?, radius(record)?);
    let (from, to) = (record.need(50)?.to_radians(), record.need(51)?.to_radians());
    let mut sweep = (to - from).rem_euclid(TAU);
    if sweep < 1e-12 {
        sweep = TAU;
    }
    let at = |angle: f64| {
        [
            centre[0] + radius * angle.cos(),
            centre[1] + radius * angle.sin(),
        ]
    };
    // The bulge of a nearly full turn is too large to be exact.
    let pieces = if sweep > 1.6 * std::f64::consts::PI {
        2
    } else {
        1
    };
    let bulge = (sweep / f64::from(pieces) / 4.0).tan();
    let segments: Vec<Segment> = (0..pieces)
        .map(|k| {
            let part = |k: i32| from + sweep * f64::from(k) / f64::from(pieces);
            Segment {
                from: at(part(k)),
                to: at(part(k + 1)),
                bulge,
            }
        })
        .collect();
    let mut path = Path::from_segments(&segments, 0);
    if sweep > TAU - 1e-9 {
        path.vertices.pop();
        path.closed = true;
    }
    Ok(map_path(record.plane()?, &path, TOLERANCE))
}

/// Checks the bulges of segments and makes the path. A segment that is less high than a part of the
/// tolerance (0.0001 mm) is a line, one with a radius beyond the limit below the whole tolerance.
fn bulged(
    record: &Record,
    mut vertices: Vec<Vertex>,
    closed: bool,
    tolerance: f64,
) -> Result<Read, Problem> {
    /// Height of an arc above its chord, as a part of the tolerance.
    const FLAT: f64 = 0.04;
    /// A rounder arc stays one, however small it is.
    const ROUND: f64 = 0.01;
    let mut is_lost = false;
    vertices.dedup_by(|next, before| {
        let same = next.at == before.at;
        if same {
            is_lost |= before.bulge != 0.0;
            // A segment without length keeps the bulge of the segment after it.
            before.bulge = next.bulge;
        }
        same
    });
    let mut closed = closed;
    if vertices.len() > 2 && closed && vertices[0].at == vertices[vertices.len() - 1].at {
        is_lost |= vertices.pop().is_some_and(|last| last.bulge != 0.0);
    }
    if vertices.len() < 2 {
        return Ok(Read::LeftOut("it has no length".into()));
    }
    if !closed && vertices.len() > 3 && vertices[0].at == vertices[vertices.len() - 1].at {
        // Drawn shut without the flag.
        vertices.pop();
        closed = true;
    }
    let mut path = Path {
        vertices,
        closed,
        entity: 0,
    };
    for index in 0..path.segment_count() {
        let segment = path.segment(index);
        let height = segment.bulge.abs() * distance(segment.from, segment.to) / 2.0;
        // A longer segment within the tolerance is a line where its arc is too large to compute.
        let is_huge = segment
            .arc()
            .is_some_and(|arc| arc.radius > RADIUS_LIMIT || !arc.radius.is_finite());
        if height < FLAT * tolerance && segment.bulge.abs() < ROUND || height < tolerance && is_huge
        {
            path.vertices[index].bulge = 0.0;
        }
    }
    for (index, segment) in path.segments().enumerate() {
        if let Some(arc) = segment.arc()
            && (arc.radius > RADIUS_LIMIT || !arc.radius.is_finite())
        {
            let what = format!(
                "the bulge {:e} after vertex {} is an arc with the radius {:.3e}",
                segment.bulge,
                index + 1,
                arc.radius
            );
            return Err(record.refuse(what, "draw this segment again"));
        }
        if segment.bulge.abs() > 50.0 {
            let what = format!(
                "the bulge {:e} after vertex {} is a full turn within {:.2} degrees",
                segment.bulge,
                index + 1,
                360.0 - 4.0 * segment.bulge.abs().atan().to_degrees()
            );
            return Err(record.refuse(what, "draw this segment as a circle"));
        }
    }
    let mut read = shapes(vec![map_path(record.plane()?, &path, TOLERANCE)]);
    if let (Read::Shapes(shapes), true) = (&mut read, is_lost) {
        shapes.notes.insert(NO_SEGMENT);
    }
    Ok(read)
}

/// Note on an arc whose ends are one point.
const NO_SEGMENT: &str = "segments with a bulge and without length are left out";

fn light_polyline(record: &Record, tolerance: f64) -> Result<Read, Problem> {
    let closed = record.integer(70)?.is_some_and(|flags| flags & 1 != 0);
    let mut vertices: Vec<Vertex> = Vec::new();
    for pair in record.pairs {
        match pair.code {
            10 => vertices.push(Vertex {
                at: [record.parse(pair)?, f64::NAN],
                bulge: 0.0,
            }),
            20 | 42 => {
                let value = record.parse(pair)?;
                let Some(vertex) = vertices.last_mut() else {
                    let what = format!("group {} is before the first vertex", pair.code);
                    return Err(record.refuse(what, "repair or delete the entity"));
                };
                if pair.code == 20 {
                    vertex.at[1] = value;
                } else {
                    vertex.bulge = value;
                }
            }
            _ => {}
        }
    }
    for (index, vertex) in vertices.iter().enumerate() {
        if vertex.at[1].is_nan() {
            let what = format!("vertex {} has no group 20", index + 1);
            return Err(record.refuse(what, "repair or delete the entity"));
        }
        record.within(vertex.at)?;
    }
    if let Some(count) = record.integer(90)?
        && count != vertices.len() as i64
    {
        let what = format!("it announces {count} vertices and has {}", vertices.len());
        return Err(record.refuse(what, "repair or delete the entity"));
    }
    let widths = record.pairs.iter();
    let mut widths = widths.filter(|pair| matches!(pair.code, 40 | 41 | 43));
    let is_wide = widths.any(|pair| record.parse(pair).is_ok_and(|width| width > 0.0));
    Ok(with_width(
        bulged(record, vertices, closed, tolerance)?,
        is_wide,
    ))
}

/// What a polyline of some width draws: its middle line.
fn with_width(mut read: Read, is_wide: bool) -> Read {
    if let (Read::Shapes(shapes), true) = (&mut read, is_wide) {
        shapes
            .notes
            .insert("wide polylines are cut along their middle");
    }
    read
}

/// Reads a POLYLINE with the records of its vertices.
pub fn polyline(
    record: &Record,
    parts: &[(usize, Vec<Pair>)],
    tolerance: f64,
) -> Result<Read, Problem> {
    let flags = record.integer(70)?.unwrap_or(0);
    if flags & (16 | 64) != 0 {
        return Ok(Read::LeftOut("POLYLINE is a mesh".into()));
    }
    let mut is_wide = record.or(40, 0.0)? > 0.0 || record.or(41, 0.0)? > 0.0;
    let mut vertices = Vec::new();
    for (line, pairs) in parts {
        let part = Record {
            kind: "VERTEX",
            line: *line,
            pairs,
        };
        // Control points of a spline frame are not on the curve.
        if part.integer(70)?.unwrap_or(0) & 16 != 0 {
            continue;
        }
        is_wide |= part.or(40, 0.0)? > 0.0 || part.or(41, 0.0)? > 0.0;
        vertices.push(Vertex {
            at: part.point(10, 20)?,
            bulge: part.or(42, 0.0)?,
        });
    }
    Ok(with_width(
        bulged(record, vertices, flags & 1 != 0, tolerance)?,
        is_wide,
    ))
}

/// Whether an axis of an ellipse has no length.
fn is_flat(record: &Record) -> Result<bool, Problem> {
    let major = [record.need(11)?, record.need(21)?];
    Ok(major == [0.0, 0.0] || record.need(40)? == 0.0)
}

fn ellipse(record: &Record, tolerance: f64) -> Result<Path, Problem> {
    record.plane()?;
    let centre = record.point(10, 20)?;
    let major = [record.need(11)?, record.need(21)?];
    let ratio = record.need(40)?;
    // Some programs write the shorter axis first, with a ratio above 1.
    if ratio <= 0.0 {
        let ratio = short(ratio);
        let what = format!("the ratio {ratio} of its axes is not above 0");
        return Err(record.refuse(what, "repair or delete the entity"));
    }
    let side = if record.or(230, 1.0)? < 0.0 {
        -ratio
    } else {
        ratio
    };
    let map = Affine::new([
        major[0],
        major[1],
        -major[1] * side,
        major[0] * side,
        centre[0],
        centre[1],
    ]);
    let (from, to) = (record.or(41, 0.0)?, record.or(42, TAU)?);
    let mut sweep = (to - from).rem_euclid(TAU);
    if sweep < 1e-9 {
        sweep = TAU;
    }
    let mut segments = Vec::new();
    fit_ellipse(
        map,
        [0.0, 0.0],
        1.0,
        [from, from + sweep],
        tolerance,
        &mut segments,
    );
    let mut path = Path::from_segments(&segments, 0);
    if sweep > TAU - 1e-9 {
        path.vertices.pop();
        path.closed = true;
    }
    Ok(path)
}

fn spline(record: &Record, tolerance: f64) -> Result<Path, Problem> {
    let numbers = |code: i32| -> Result<Vec<f64>, Problem> {
        let all = record.pairs.iter().filter(|pair| pair.code == code);
        all.map(|pair| record.parse(pair)).collect()
    };
    let (xs, ys) = (numbers(10)?, numbers(20)?);
    if xs.is_empty() {
        return Err(record.refuse(
            "it has fit points only, and no control points",
            "save the drawing with control points, or convert the spline to a polyline",
        ));
    }
    if xs.len() != ys.len() {
        return Err(record.refuse(
            "a control point lacks x or y",
            "repair or delete the entity",
        ));
    }
    let points: Vec<Point> = xs.into_iter().zip(ys).map(|(x, y)| [x, y]).collect();
    for &at in &points {
        record.within(at)?;
    }
    let mut weights = numbers(41)?;
    if weights.is_empty() {
        weights = vec![1.0; points.len()];
    }
    let degree = record.integer(71)?.unwrap_or(3).max(0) as usize;
    let nurbs = Nurbs {
        degree,
        knots: numbers(40)?,
        points,
        weights,
    };
    if let Some(what) = nurbs.mistake() {
        return Err(record.refuse(what, "repair or delete the entity"));
    }
    let mut segments = Vec::new();
    nurbs.fit(tolerance, &mut segments);
    let mut path = Path::from_segments(&segments, 0);
    let meets = path
        .start()
        .zip(path.end())
        .is_some_and(|(a, b)| distance(a, b) < 1e-6);
    if meets && path.vertices.len() > 2 {
        path.vertices.pop();
        path.closed = true;
    }
    Ok(path)
}

/// Outline of a filled triangle or quadrangle. Its third and fourth corner are crossed.
fn solid(record: &Record) -> Result<Path, Problem> {
    let mut corners = vec![record.point(10, 20)?, record.point(11, 21)?];
    let third = record.point(12, 22)?;
    let fourth = if record.value(13).is_some() {
        record.point(13, 23)?
    } else {
        third
    };
    corners.push(fourth);
    corners.push(third);
    corners.dedup();
    Ok(map_path(
        record.plane()?,
        &Path::polygon(&corners, 0),
        TOLERANCE,
    ))
}

fn insert(record: &Record) -> Result<Insert, Problem> {
    let name = record.value(2).map(|pair| pair.text().trim().to_string());
    let Some(block) = name.filter(|name| !name.is_empty()) else {
        return Err(record.refuse("it names no block", "repair or delete the entity"));
    };
    let at = record.point(10, 20)?;
    let scale = [record.or(41, 1.0)?, record.or(42, 1.0)?];
    if scale.contains(&0.0) {
        let what = format!("its scale is {} x {}", short(scale[0]), short(scale[1]));
        return Err(record.refuse(what, "repair or delete the block reference"));
    }
    let angle = record.or(50, 0.0)?.to_radians();
    let count = |code| -> Result<i64, Problem> { Ok(record.integer(code)?.unwrap_or(1).max(1)) };
    let (columns, rows) = (count(70)?, count(71)?);
    if columns.saturating_mul(rows) > ENTITY_LIMIT as i64 {
        let what = format!("it is an array of {columns} x {rows} copies");
        return Err(record.refuse(what, "make the array smaller"));
    }
    let (dx, dy) = (record.or(44, 0.0)?, record.or(45, 0.0)?);
    let plane = record.plane()?;
    let mut maps = Vec::new();
    for row in 0..rows {
        for column in 0..columns {
            maps.push(
                plane
                    * Affine::translate((at[0], at[1]))
                    * Affine::rotate(angle)
                    * Affine::translate((dx * column as f64, dy * row as f64))
                    * Affine::scale_non_uniform(scale[0], scale[1]),
            );
        }
    }
    Ok(Insert { block, maps })
}
