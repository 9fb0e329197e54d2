//! Orders of the thesis: its worked example, its pocket scenarios, and five squares.
//!
//! Source: C. Mitravakin, *Tool path analysis for engraving machine*, KMITL, 2002: figures 4.8,
//! 4.10 and 4.12, and section 4.2.2. The totals are computed from the printed coordinates.

use haptimill_engrave::geometry::Point;
use haptimill_engrave::order::edges::{Condition, Ends, analyse, order};
use haptimill_engrave::order::rows::{Line, contours, totals, zigzag};

const REFERENCE: Point = [0.0, 0.0];

fn ends(line: [f64; 4]) -> Ends {
    Ends {
        start: [line[0], line[1]],
        end: [line[2], line[3]],
    }
}

/// Figure 4.10: the lines of figure 4.8 in the order of the file.
const FIGURE_4_10: [[f64; 4]; 4] = [
    [10.0, 30.0, 20.0, 40.0],
    [20.0, 40.0, 40.0, 30.0],
    [20.0, 20.0, 40.0, 10.0],
    [40.0, 25.0, 40.0, 20.0],
];

#[test]
fn conditions_of_figure_4_8() {
    let commands = FIGURE_4_10.map(ends);
    let expected: [(&[usize], f64); 5] = [
        (&[0, 1, 2, 3], 113.705),
        (&[0, 1, 2, 3], 113.705),
        (&[0, 1, 3, 2], 97.854),
        (&[2, 0, 1, 3], 114.061),
        (&[2, 3, 1, 0], 146.290),
    ];
    for (condition, (sequence, total)) in Condition::ALL.into_iter().zip(expected) {
        let found = order(&commands, condition, REFERENCE);
        assert_eq!(found.order, sequence, "{condition:?}");
        assert_eq!(
            format!("{:.3}", found.air_mm),
            format!("{total:.3}"),
            "{condition:?}"
        );
    }
    let best = analyse(&commands, REFERENCE);
    assert_eq!(best.condition, Condition::FirstLift);
    // Figure 4.12: the list of the file after the analysis.
    let figure_4_12 = [
        FIGURE_4_10[0],
        FIGURE_4_10[1],
        FIGURE_4_10[3],
        FIGURE_4_10[2],
    ];
    let listed: Vec<Ends> = best.order.iter().map(|&index| commands[index]).collect();
    assert_eq!(listed, figure_4_12.map(ends));
}

fn rectangle(low: Point, high: Point) -> Vec<Point> {
    vec![low, [high[0], low[1]], high, [low[0], high[1]]]
}

fn edges(corners: &[Point]) -> Vec<Line> {
    (0..corners.len())
        .map(|k| [corners[k], corners[(k + 1) % corners.len()]])
        .collect()
}

#[test]
fn five_squares() {
    let corners = [
        [80.0, 10.0],
        [10.0, 10.0],
        [80.0, 60.0],
        [10.0, 60.0],
        [45.0, 35.0],
    ];
    let commands: Vec<Ends> = corners
        .iter()
        .flat_map(|&at: &Point| edges(&rectangle(at, [at[0] + 15.0, at[1] + 15.0])))
        .map(|line| Ends {
            start: line[0],
            end: line[1],
        })
        .collect();
    let expected = [
        (
            406.6662,
            "1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20",
        ),
        (
            406.6458,
            "1 2 3 4 5 6 7 8 17 18 19 20 13 14 15 16 9 10 11 12",
        ),
        (
            270.0092,
            "1 2 3 4 18 19 20 17 9 10 11 12 14 15 16 13 7 8 5 6",
        ),
        (
            336.1886,
            "5 6 7 8 17 18 19 20 13 14 15 16 1 2 3 4 9 10 11 12",
        ),
        (
            262.9847,
            "5 6 7 8 17 18 19 20 14 15 16 13 9 10 11 12 4 1 2 3",
        ),
    ];
    for (condition, (total, sequence)) in Condition::ALL.into_iter().zip(expected) {
        let found = order(&commands, condition, REFERENCE);
        let shown: Vec<String> = found
            .order
            .iter()
            .map(|index| (index + 1).to_string())
            .collect();
        assert_eq!(shown.join(" "), sequence, "{condition:?}");
        assert_eq!(
            format!("{:.4}", found.air_mm),
            format!("{total:.4}"),
            "{condition:?}"
        );
    }
    assert_eq!(
        analyse(&commands, REFERENCE).condition,
        Condition::NearestLift
    );
}

/// Diameter of the cutter of the pocket scenarios, mm.
const TOOL: f64 = 0.9;

/// Horizontal rows half a diameter apart between the edges of loops, from the top, left to right.
fn hatch(loops: &[Vec<Point>]) -> Vec<Line> {
    let spacing = TOOL / 2.0;
    let ys = || loops.iter().flatten().map(|at| at[1]);
    let low = (ys().fold(f64::INFINITY, f64::min) / spacing).floor() as i64 + 1;
    let high = (ys().fold(f64::NEG_INFINITY, f64::max) / spacing).ceil() as i64 - 1;
    let mut rows = Vec::new();
    for k in (low..=high).rev() {
        let y = k as f64 * spacing;
        let mut crossings: Vec<f64> = loops
            .iter()
            .flat_map(|corners| edges(corners))
            .filter(|[a, b]| (a[1] <= y) != (b[1] <= y))
            .map(|[a, b]| a[0] + (y - a[1]) * (b[0] - a[0]) / (b[1] - a[1]))
            .collect();
        crossings.sort_by(f64::total_cmp);
        for pair in crossings.chunks_exact(2) {
            if pair[1] - pair[0] > 1e-9 {
                rows.push([[pair[0], y], [pair[1], y]]);
            }
        }
    }
    rows
}

struct Scenario {
    name: &'static str,
    loops: Vec<Vec<Point>>,
    rows: usize,
    /// Cut, air, lifts without analysis.
    plain: (f64, f64, usize),
    /// Cut, air, lifts, links with analysis.
    analysed: (f64, f64, usize, usize),
    /// Percent saved with a lift cycle of 4 s, at 5 mm/s.
    saved: f64,
}

fn scenarios() -> [Scenario; 3] {
    let r = TOOL / 2.0;
    // The letter H of 25 x 35 mm with strokes of 5 mm, made smaller by the radius of the cutter.
    let h = [
        [10.0 + r, 10.0 + r],
        [15.0 - r, 10.0 + r],
        [15.0 - r, 25.0 + r],
        [30.0 + r, 25.0 + r],
        [30.0 + r, 10.0 + r],
        [35.0 - r, 10.0 + r],
        [35.0 - r, 45.0 - r],
        [30.0 + r, 45.0 - r],
        [30.0 + r, 30.0 - r],
        [15.0 - r, 30.0 - r],
        [15.0 - r, 45.0 - r],
        [10.0 + r, 45.0 - r],
    ];
    [
        Scenario {
            name: "S1",
            loops: vec![rectangle([10.0 + r, 10.0 + r], [30.0 - r, 30.0 - r])],
            rows: 42,
            plain: (878.6, 848.358, 43),
            analysed: (897.35, 46.371, 1, 42),
            saved: 62.75,
        },
        Scenario {
            name: "S2",
            loops: vec![
                rectangle([10.0, 10.0], [50.0, 50.0]),
                rectangle([20.0 - r, 20.0 - r], [40.0 + r, 40.0 + r]),
            ],
            rows: 135,
            plain: (2842.2, 4592.195, 137),
            analysed: (2902.3, 74.059, 3, 134),
            saved: 70.16,
        },
        Scenario {
            name: "S3",
            loops: vec![h.to_vec()],
            rows: 141,
            plain: (934.5, 2917.738, 142),
            analysed: (996.15, 136.187, 5, 137),
            saved: 81.59,
        },
    ]
}

#[test]
fn pocket_scenarios() {
    for scenario in scenarios() {
        let rows = hatch(&scenario.loops);
        assert_eq!(rows.len(), scenario.rows, "{}", scenario.name);
        let outlines: Vec<Vec<Line>> = scenario.loops.iter().map(|one| edges(one)).collect();
        let plain: Vec<Line> = outlines.iter().flatten().chain(&rows).copied().collect();
        let mut analysed = zigzag(&rows, REFERENCE);
        let last = analysed[analysed.len() - 1][1];
        analysed.extend(contours(&outlines, last));
        let anywhere = |_: Point, _: Point| true;
        let before = totals(&plain, REFERENCE, None, &anywhere);
        let after = totals(&analysed, REFERENCE, Some(TOOL), &anywhere);
        let near = |a: f64, b: f64| (a - b).abs() < 0.0006;
        let (cut, air, lifts) = scenario.plain;
        assert!(
            near(before.cut_mm, cut) && near(before.air_mm, air),
            "{before:?}"
        );
        assert_eq!(
            (before.lifts, before.links),
            (lifts, 0),
            "{}",
            scenario.name
        );
        let (cut, air, lifts, links) = scenario.analysed;
        assert!(
            near(after.cut_mm, cut) && near(after.air_mm, air),
            "{after:?}"
        );
        assert_eq!(
            (after.lifts, after.links),
            (lifts, links),
            "{}",
            scenario.name
        );
        let time = |totals: &haptimill_engrave::order::rows::Totals| {
            (totals.cut_mm + totals.air_mm) / 5.0 + totals.lifts as f64 * 4.0
        };
        let saved = 100.0 * (1.0 - time(&after) / time(&before));
        assert!(
            (saved - scenario.saved).abs() < 0.006,
            "{} {saved}",
            scenario.name
        );
    }
}

#[test]
fn the_square_begins_at_its_lowest_row_and_alternates() {
    let [square, ..] = scenarios();
    let rows = hatch(&square.loops);
    let order = zigzag(&rows, REFERENCE);
    assert!((order[0][0][0] - 10.45).abs() < 1e-9 && (order[0][0][1] - 10.8).abs() < 1e-9);
    for (index, row) in order.iter().enumerate() {
        assert_eq!(row[1][0] > row[0][0], index % 2 == 0);
    }
    // With a limit below the row spacing only the way to the contour is a link.
    let outlines: Vec<Vec<Line>> = square.loops.iter().map(|one| edges(one)).collect();
    let mut all = order.clone();
    all.extend(contours(&outlines, order[order.len() - 1][1]));
    let totals = totals(&all, REFERENCE, Some(0.4), &|_, _| true);
    assert_eq!((totals.links, totals.lifts), (1, 42));
}
