//! Leads and tabs: leads stay in the waste, tabs stay at their width.

use super::*;
use haptimill_engrave::geometry::distance;

/// Points of the tool's centre in the material, closely along its way, with their Z.
pub(super) fn places(job: &Job) -> Vec<(Point, f64)> {
    let mut out = Vec::new();
    for cut in &job.toolpath.cuts {
        let mut z = cut.z;
        for step in &cut.steps {
            match step {
                PathStep::Vertical(to) => z = *to,
                PathStep::Along(segment, to) => {
                    let count = (segment.length() / 0.01).ceil().max(1.0) as usize;
                    for k in 0..=count {
                        let part = k as f64 / count as f64;
                        out.push((segment.point(part), z + (to - z) * part));
                    }
                    z = *to;
                }
            }
        }
    }
    out
}

/// How far a point is inside of a square (x, y, side), mm; negative outside.
fn depth_in([x, y, side]: [f64; 3], at: Point) -> f64 {
    let across = |value: f64, low: f64| (value - low).min(low + side - value);
    across(at[0], x).min(across(at[1], y))
}

pub(super) fn has_lead(cut: &Cut) -> bool {
    matches!(cut.steps[0], PathStep::Along(one, _)
        if (one.bulge.abs() - std::f64::consts::FRAC_PI_8.tan()).abs() < 1e-9)
}

/// The tool stays its radius away from the walls on its leads, too, inside of a contour and in the
/// hole of a part. A lead that fits nowhere is left out, with a notice.
#[test]
fn leads_stay_in_the_waste() {
    let inner = [10.0, 10.0, 10.0];
    let outer = [0.0, 0.0, 30.0];
    for conventional in [false, true] {
        for finish_mm in [0.0, 0.2] {
            let options = Options {
                side: Side::Inside,
                conventional,
                finish_mm,
                lead_mm: Some(1.0),
                depth_mm: 0.3,
                ..Options::default()
            };
            let job = plan(&drawing(&dxf(&squares(&[inner]))), &options).unwrap();
            assert!(job.toolpath.cuts.iter().all(has_lead), "{:?}", job.notices);
            for (at, _) in places(&job) {
                assert!(depth_in(inner, at) > 0.5 - 1e-4, "{at:?} {options:?}");
            }
            let options = Options {
                side: Side::Outside,
                ..options
            };
            let part = drawing(&dxf(&squares(&[outer, inner])));
            let job = plan(&part, &options).unwrap();
            assert!(job.toolpath.cuts.iter().all(has_lead), "{:?}", job.notices);
            for (at, _) in places(&job) {
                let in_hole = depth_in(inner, at) > 0.5 - 1e-4;
                let around = {
                    let near = at.map(|one| one.clamp(0.0, 30.0));
                    distance(near, at) > 0.5 - 1e-4
                };
                assert!(in_hole || around, "{at:?} {options:?}");
            }
        }
    }
    let options = Options {
        side: Side::Inside,
        lead_mm: Some(6.0),
        ..Options::default()
    };
    let job = plan(&drawing(&dxf(&squares(&[inner]))), &options).unwrap();
    assert!(!has_lead(&job.toolpath.cuts[0]));
    assert!(job.notices.iter().any(|one| one.contains("no room")));
}

/// A contour at a distance around a convex polygon that runs counter-clockwise.
pub(super) fn ring(corners: &[Point], off: f64) -> Vec<Point> {
    let count = corners.len();
    let normal = |k: usize| {
        let (a, b) = (corners[k % count], corners[(k + 1) % count]);
        let length = distance(a, b);
        [(b[1] - a[1]) / length, (a[0] - b[0]) / length]
    };
    let mut out = Vec::new();
    for k in 0..count {
        let (a, b) = (corners[k], corners[(k + 1) % count]);
        let (n, next) = (normal(k), normal(k + 1));
        let steps = (distance(a, b) / 0.02) as usize;
        for step in 0..steps {
            let part = step as f64 / steps as f64;
            out.push(std::array::from_fn(|axis| {
                a[axis] + (b[axis] - a[axis]) * part + off * n[axis]
            }));
        }
        let (first, last) = (n[1].atan2(n[0]), next[1].atan2(next[0]));
        let turn = (last - first).rem_euclid(std::f64::consts::TAU);
        let steps = (turn * off / 0.02) as usize;
        for step in 0..steps {
            let angle = first + turn * step as f64 / steps as f64;
            out.push([b[0] + off * angle.cos(), b[1] + off * angle.sin()]);
        }
    }
    out
}

/// Widths of what is left up to a height on a ring, as distances of its two ends, mm.
pub(super) fn widths(plate: &Plate, ring: &[Point], top: f64) -> Vec<f64> {
    let (low, cell) = (plate.at(0, 0), plate.at(1, 0)[0] - plate.at(0, 0)[0]);
    let left = |at: &Point| {
        let [column, row] = [0, 1].map(|axis| ((at[axis] - low[axis]) / cell).round() as usize);
        f64::from(plate.heights()[row * plate.size()[0] + column]) > top - 1e-4
    };
    let first = ring
        .iter()
        .position(|at| !left(at))
        .expect("nothing is cut");
    let mut out = Vec::new();
    let mut begin: Option<Point> = None;
    let mut last = ring[first];
    for at in ring[first..].iter().chain(&ring[..=first]) {
        match (left(at), begin) {
            (true, None) => begin = Some(*at),
            (false, Some(from)) => {
                out.push(distance(from, last));
                begin = None;
            }
            _ => {}
        }
        last = *at;
    }
    out
}

/// Every tab has its width and height after all passes, with ramps, finishing passes and leads, and
/// where a corner is in its place.
#[test]
fn tabs_keep_their_width_in_every_pass() {
    let square = [[10.0, 10.0], [30.0, 10.0], [30.0, 30.0], [10.0, 30.0]];
    let pointed = [[10.0, 10.0], [40.0, 10.0], [40.0, 22.0]];
    for corners in [&square[..], &pointed] {
        let part = drawing(&dxf(&outline(corners)));
        for count in 1..=5 {
            for (ramp_deg, finish_mm, lead_mm) in [
                (None, 0.0, None),
                (Some(3.0), 0.0, None),
                (None, 0.4, None),
                (Some(3.0), 0.4, Some(0.5)),
            ] {
                let tabs = Tabs {
                    count,
                    width_mm: 2.0,
                    height_mm: 1.6,
                };
                let options = Options {
                    side: Side::Outside,
                    tool_mm: 2.0,
                    depth_mm: 3.0,
                    step_mm: 0.75,
                    tabs: Some(tabs),
                    ramp_deg,
                    finish_mm,
                    lead_mm,
                    ..Options::default()
                };
                let job = plan(&part, &options).unwrap();
                let mut plate = Plate::new(area(&part, &options), 0.05);
                cut(&mut plate, &job, options.tool_mm);
                for off in [1.0, 1.0 + finish_mm] {
                    let found = widths(&plate, &ring(corners, off), -1.4);
                    let state = format!("{count} {ramp_deg:?} {finish_mm} {off}: {found:?}");
                    assert_eq!(found.len(), count, "{state}");
                    for width in found {
                        assert!(width > 1.85 && width < 3.0, "{state}");
                    }
                }
            }
        }
    }
}

/// Tabs of a traced contour are at the same places in all passes.
#[test]
fn tabs_of_a_traced_contour_stay_in_place_with_a_ramp() {
    let part = drawing(&dxf(&squares(&[[10.0, 10.0, 20.0]])));
    let options = Options {
        tool_mm: 1.0,
        depth_mm: 2.0,
        step_mm: 0.25,
        ramp_deg: Some(2.0),
        tabs: Some(Tabs {
            count: 4,
            width_mm: 2.0,
            height_mm: 1.2,
        }),
        ..Options::default()
    };
    let job = plan(&part, &options).unwrap();
    let mut plate = Plate::new(area(&part, &options), 0.05);
    cut(&mut plate, &job, options.tool_mm);
    let corners = [[10.0, 10.0], [30.0, 10.0], [30.0, 30.0], [10.0, 30.0]];
    let found = widths(&plate, &ring(&corners, 0.0), -0.8);
    assert!(
        found.len() == 4 && found.iter().all(|one| *one > 1.85),
        "{found:?}"
    );
    // The ramp is no steeper than its angle but over the tabs.
    let steepest = job.toolpath.cuts.iter().flat_map(|cut| {
        let mut z = cut.z;
        cut.steps.iter().filter_map(move |step| match step {
            PathStep::Along(segment, to) => {
                let slope = (z - to) / segment.length();
                z = *to;
                Some(slope)
            }
            PathStep::Vertical(to) => {
                z = *to;
                None
            }
        })
    });
    let steepest = steepest.fold(0.0, f64::max);
    assert!(steepest <= 2.0_f64.to_radians().tan() + 1e-6, "{steepest}");
}

/// A finishing allowance within the tool's radius leaves nothing in slots of any width; a larger
/// one is refused.
#[test]
fn a_finishing_allowance_leaves_nothing_uncut() {
    for width in [1.3, 1.9, 2.1, 2.5, 4.8] {
        let corners = [
            [5.0, 5.0],
            [35.0, 5.0],
            [35.0, 5.0 + width],
            [5.0, 5.0 + width],
        ];
        let slot = drawing(&dxf(&outline(&corners)));
        for clearing in [Clearing::Contour, Clearing::Zigzag, Clearing::OneWay] {
            for finish_mm in [0.1, 0.3, 0.5] {
                let options = Options {
                    clearing,
                    finish_mm,
                    depth_mm: 0.5,
                    ..pocket()
                };
                check(&slot, &options);
            }
            for finish_mm in [0.6, 2.0] {
                let options = Options {
                    clearing,
                    finish_mm,
                    depth_mm: 0.5,
                    ..pocket()
                };
                let problems = plan(&slot, &options).unwrap_err();
                assert!(problems[0].message.contains("finishing"), "{problems:?}");
                assert!(problems[0].message.contains("radius"), "{problems:?}");
            }
        }
    }
}

/// Tabs wider than a small hole is round do not keep the tool from cutting it; that they are
/// narrower is a notice.
#[test]
fn tabs_of_a_small_circle_are_narrower_with_a_notice() {
    let hole = drawing(&dxf("0 CIRCLE\n5 A1\n8 Cut\n10 20\n20 20\n40 3"));
    let options = |width_mm| Options {
        side: Side::Inside,
        tool_mm: 2.0,
        depth_mm: 3.0,
        tabs: Some(Tabs {
            count: 1,
            width_mm,
            height_mm: 1.0,
        }),
        ..Options::default()
    };
    // The tool's centre runs on a circle of 4 mm: at most 2 mm are left between its ends.
    for (width, is_noted) in [(1.0, false), (3.0, true)] {
        let job = plan(&hole, &options(width)).unwrap();
        let noted = job
            .notices
            .iter()
            .any(|one| one.contains("handle A1") && one.contains("tabs"));
        assert_eq!(noted, is_noted, "{:?}", job.notices);
        let deep = places(&job).iter().filter(|one| one.1 < -2.99).count();
        assert!(deep as f64 * 0.01 > 0.9 * (4.0 * std::f64::consts::PI - width - 2.0) - 1.0);
    }
}

/// The finishing pass begins elsewhere than the pass before it, because it follows another part;
/// the tabs are at the same places.
#[test]
fn tabs_are_at_the_same_places_in_the_finishing_pass() {
    let parts = [[10.0, 10.0, 20.0], [45.0, 15.0, 20.0], [15.0, 50.0, 20.0]];
    let drawn = drawing(&dxf(&squares(&parts)));
    for count in [1, 2, 3] {
        for conventional in [false, true] {
            let options = Options {
                side: Side::Outside,
                conventional,
                tool_mm: 2.0,
                depth_mm: 3.0,
                finish_mm: 0.4,
                tabs: Some(Tabs {
                    count,
                    width_mm: 2.0,
                    height_mm: 1.6,
                }),
                ..Options::default()
            };
            let job = plan(&drawn, &options).unwrap();
            let mut plate = Plate::new(area(&drawn, &options), 0.05);
            cut(&mut plate, &job, options.tool_mm);
            for [x, y, side] in parts {
                let corners = [[x, y], [x + side, y], [x + side, y + side], [x, y + side]];
                for off in [0.5, 1.0, 1.4] {
                    let found = widths(&plate, &ring(&corners, off), -1.4);
                    let state = format!("{count} {x} {off}: {found:?}");
                    assert_eq!(found.len(), count, "{state}");
                    assert!(found.iter().all(|width| *width > 1.85), "{state}");
                }
            }
        }
    }
}
