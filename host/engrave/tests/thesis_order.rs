//! Orders of the thesis: its worked example, its pocket scenarios, and five squares.
//!
//! Source: C. Mitravakin, *Tool path analysis for engraving machine*, KMITL, 2002: figures 4.8,
//! 4.10 and 4.12, and section 4.2.2. The totals are computed from the printed coordinates.

use haptimill_engrave::geometry::Point;
use haptimill_engrave::order::edges::{Condition, Ends, analyse, order};
use haptimill_engrave::order::rows::{Line, contours, totals, zigzag};
use haptimill_engrave::thesis::{
    FIGURE_4_10, KIND, REFERENCE, Row, Verdict, five_squares as squares, hatch, pocket, pockets,
    polygon, rows, saved,
};

fn ends(line: [f64; 4]) -> Ends {
    Ends {
        start: [line[0], line[1]],
        end: [line[2], line[3]],
    }
}

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

#[test]
fn five_squares() {
    let commands = squares();
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
    let [s1, s2, s3] = pockets();
    [
        Scenario {
            name: "S1",
            loops: s1,
            rows: 42,
            plain: (878.6, 848.358, 43),
            analysed: (897.35, 46.371, 1, 42),
            saved: 62.75,
        },
        Scenario {
            name: "S2",
            loops: s2,
            rows: 135,
            plain: (2842.2, 4592.195, 137),
            analysed: (2902.3, 74.059, 3, 134),
            saved: 70.16,
        },
        Scenario {
            name: "S3",
            loops: s3,
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
        let (count, before, after) = pocket(&scenario.loops);
        assert_eq!(count, scenario.rows, "{}", scenario.name);
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
        let saved = saved(&before, &after);
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
    let outlines: Vec<Vec<Line>> = square.loops.iter().map(|one| polygon(one)).collect();
    let mut all = order.clone();
    all.extend(contours(&outlines, order[order.len() - 1][1]));
    let totals = totals(&all, REFERENCE, Some(0.4), &|_, _| true);
    assert_eq!((totals.links, totals.lifts), (1, 42));
}

/// The table of `haptimill scenario run engraver`: what differs from the thesis has a reason.
#[test]
fn the_table_of_the_thesis_is_complete() {
    let rows = rows().expect("numbers of the thesis");
    for section in ["5.1", "4.2.1", "5.2", "5.3", "5.4"] {
        assert!(rows.iter().any(|row| row.section == section), "{section}");
    }
    for row in &rows {
        assert!(
            row.verdict == Verdict::Agrees || !row.reason.is_empty(),
            "{row:?}"
        );
        // A shape that stands in for a lost drawing never counts as the drawing.
        let stands_in = matches!(row.section, "5.2" | "5.3");
        assert!(!stands_in || row.verdict != Verdict::Agrees, "{row:?}");
        if stands_in {
            let percent = |text: &str| text.trim_end_matches(" %").parse::<f64>().unwrap();
            let (stated, ours) = (percent(&row.stated), percent(&row.ours));
            // A small saving is of the same kind as none only if it is none.
            let is_close =
                (stated - ours).abs() <= KIND && ours >= 0.5 * stated && ours <= 2.0 * stated;
            assert_eq!(row.verdict == Verdict::SameKind, is_close, "{row:?}");
        }
    }
    // Table 5.1: the times give its printed column; 79.255 % is printed as 79.25.
    let printed = ["17.89", "5.88", "68.31", "72.79", "79.26", "81.29"];
    let stated = rows.iter().filter(|row| row.section == "5.2");
    let stated: Vec<&str> = stated.map(|row| &*row.stated).collect();
    assert_eq!(stated, printed.map(|percent| format!("{percent} %")));
    let differs: Vec<&str> = rows
        .iter()
        .filter(|row| row.verdict == Verdict::Differs)
        .map(|row| &*row.what)
        .collect();
    // Four printed sums of rounded legs, and the texts, of which the fonts are others.
    assert_eq!(differs.len(), 9, "{differs:?}");
    let is_text = |what: &&str| what.contains("DejaVu");
    assert!(differs[4..].iter().all(is_text), "{differs:?}");
    // Every text of the thesis is the one that is cut here, and the analysis saves time of each.
    let texts: Vec<&Row> = rows.iter().filter(|row| is_text(&&*row.what)).collect();
    let words = ["kmitl", "VWXYZ", "ABCD", "efghij", "klmn", "opqrstu"];
    assert_eq!(texts.len(), words.len());
    for (row, word) in texts.into_iter().zip(words) {
        assert!(row.what.contains(&format!("here {word} in")), "{row:?}");
        let saved: f64 = row.ours.trim_end_matches(" %").parse().unwrap();
        assert!(saved > 2.0 && saved < 8.0, "{row:?}");
    }
}
