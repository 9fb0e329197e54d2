//! The order of cuts, its length and its time.

use super::*;

#[test]
fn holes_are_drilled_in_a_short_order() {
    let holes = layer("HOLES");
    let options = Options {
        operation: Operation::Drill,
        depth_mm: 3.0,
        step_mm: 1.0,
        tool_mm: 1.0,
        ..Options::default()
    };
    let (job, _) = check(&holes, &options);
    assert!(job.proven);
    assert_eq!(job.toolpath.cuts.len(), 4);
    assert!(job.candidates[1].lengths.air_mm <= job.candidates[0].lengths.air_mm);
    // Each pass ends at the surface and begins there again.
    assert_eq!(job.toolpath.cuts[0].steps.len(), 4);
}

#[test]
fn every_order_cuts_the_same_and_the_chosen_one_is_the_shortest() {
    let drawing = drawing(PLATE);
    let mut totals = Vec::new();
    for ordering in [Ordering::File, Ordering::Greedy, Ordering::Short] {
        let options = Options {
            ordering,
            ..Options::default()
        };
        let (job, _) = check(&drawing, &options);
        totals.push(job.toolpath.lengths([0.0; 2]));
    }
    assert!((totals[0].cut_mm - totals[2].cut_mm).abs() < 1e-6);
    assert!((totals[0].cut_mm - totals[1].cut_mm).abs() < 1e-6);
    assert!(totals[1].air_mm <= totals[0].air_mm + 1e-9);
    assert!(totals[2].air_mm < totals[1].air_mm);
}

/// The shortest air of lines that are cut to and fro an even number of times, by trying every
/// order: the tool comes up at the end of the line where it went down.
fn shortest_to_and_fro(lines: &[[Point; 2]], left: &mut Vec<usize>, at: Point) -> f64 {
    if left.is_empty() {
        return at[0].hypot(at[1]);
    }
    let mut best = f64::INFINITY;
    for k in 0..left.len() {
        let index = left.remove(k);
        for end in lines[index] {
            let gap = (end[0] - at[0]).hypot(end[1] - at[1]);
            best = best.min(gap + shortest_to_and_fro(lines, left, end));
        }
        left.insert(k, index);
    }
    best
}

/// Lines as entities of a DXF.
fn lines_dxf(lines: &[[Point; 2]]) -> Drawing {
    let entities: String = lines
        .iter()
        .map(|[[x, y], [u, v]]| format!("0 LINE\n8 Cut\n10 {x}\n20 {y}\n11 {u}\n21 {v}\n"))
        .collect();
    drawing(&dxf(&entities))
}

const FIVE_LINES: [[Point; 2]; 5] = [
    [[90.0, 10.0], [5.0, 80.0]],
    [[10.0, 12.0], [85.0, 70.0]],
    [[60.0, 5.0], [20.0, 95.0]],
    [[95.0, 90.0], [12.0, 40.0]],
    [[40.0, 30.0], [70.0, 88.0]],
];

/// With two passes the tool is where a line begins, with three at its other end: the order is the
/// shortest of the moves that are made.
#[test]
fn open_paths_in_several_passes_are_in_the_shortest_order() {
    let drawing = lines_dxf(&FIVE_LINES);
    for passes in [2.0, 4.0] {
        let options = Options {
            depth_mm: passes,
            step_mm: 1.0,
            ..Options::default()
        };
        let job = plan(&drawing, &options).unwrap();
        let best = shortest_to_and_fro(&FIVE_LINES, &mut (0..5).collect(), [0.0; 2]);
        let air = job.toolpath.lengths([0.0; 2]).air_mm;
        assert!((air - best).abs() < 1e-9, "{passes} passes: {air} {best}");
        assert!(job.proven);
    }
}

/// What the table says of an order is what the program of that order does.
#[test]
fn the_table_of_orders_has_the_lengths_of_their_programs() {
    let drawing = lines_dxf(&FIVE_LINES);
    for step_mm in [2.0, 1.0] {
        let of = |ordering| {
            let options = Options {
                depth_mm: 2.0,
                step_mm,
                ordering,
                ..Options::default()
            };
            plan(&drawing, &options).unwrap()
        };
        let (file, greedy) = (of(Ordering::File), of(Ordering::Greedy));
        let lengths = file.toolpath.lengths([0.0; 2]);
        for job in [&file, &greedy, &of(Ordering::Short)] {
            let first = &job.candidates[0].lengths;
            assert!((first.air_mm - lengths.air_mm).abs() < 1e-9, "{first:?}");
            assert!((first.cut_mm - lengths.cut_mm).abs() < 1e-9, "{first:?}");
            assert_eq!(first.lifts, lengths.lifts);
        }
        let five = greedy.candidates[..5].iter().map(|one| one.lengths.air_mm);
        let min = five.fold(f64::INFINITY, f64::min);
        assert!((greedy.toolpath.lengths([0.0; 2]).air_mm - min).abs() < 1e-9);
    }
    // A pocket: the row of one-way rows is the job of one-way rows.
    let picture = layer("PICTURE");
    for finish_mm in [0.0, 0.2] {
        let zigzag = Options {
            clearing: Clearing::Zigzag,
            depth_mm: 0.5,
            step_mm: 0.25,
            finish_mm,
            ..pocket()
        };
        let one_way = Options {
            clearing: Clearing::OneWay,
            ..zigzag
        };
        let [job, one_way] = [zigzag, one_way].map(|one| plan(&picture, &one).unwrap());
        let lengths = one_way.toolpath.lengths([0.0; 2]);
        let first = &job.candidates[0].lengths;
        assert!((first.air_mm - lengths.air_mm).abs() < 1e-9, "{first:?}");
        assert!((first.cut_mm - lengths.cut_mm).abs() < 1e-9, "{first:?}");
        assert_eq!(first.lifts, lengths.lifts);
    }
    // Contours with a finishing pass and leads, and holes in two depths.
    let frame = drawing_of_squares();
    for options in [
        Options {
            side: Side::Outside,
            finish_mm: 0.2,
            lead_mm: Some(0.5),
            depth_mm: 2.0,
            ..Options::default()
        },
        Options {
            side: Side::Inside,
            ..Options::default()
        },
    ] {
        let job = plan(&frame, &options).unwrap();
        let [file, chosen] = [0, 1].map(|k| &job.candidates[k].lengths);
        assert!(
            (file.cut_mm - chosen.cut_mm).abs() < 1e-6,
            "{file:?} {chosen:?}"
        );
        assert_eq!(file.lifts, chosen.lifts);
    }
}

fn drawing_of_squares() -> Drawing {
    drawing(&dxf(&squares(&[[0.0, 0.0, 30.0], [5.0, 5.0, 20.0]])))
}

/// Figure 4.8 as a job: condition 2 of the thesis is chosen, and the program has the order of
/// figure 4.12. Lines 1 and 2 join, so they are one cut.
#[test]
fn the_greedy_job_of_figure_4_8_has_the_order_of_figure_4_12() {
    let lines = FIGURE_4_10.map(|[x, y, u, v]| [[x, y], [u, v]]);
    let options = Options {
        ordering: Ordering::Greedy,
        ..Options::default()
    };
    let job = plan(&lines_dxf(&lines), &options).unwrap();
    let cuts: Vec<[Point; 2]> = job
        .toolpath
        .cuts
        .iter()
        .map(|cut| [cut.start, cut.end()])
        .collect();
    let expected = [
        [[10.0, 30.0], [40.0, 30.0]],
        [[40.0, 25.0], [40.0, 20.0]],
        [[20.0, 20.0], [40.0, 10.0]],
    ];
    assert_eq!(cuts, expected);
    let air: Vec<String> = job
        .candidates
        .iter()
        .map(|one| format!("{:.3}", one.lengths.air_mm))
        .collect();
    let stated = [
        "113.705", "113.705", "97.854", "114.061", "146.290", "97.854",
    ];
    assert_eq!(air, stated);
}

/// A path of a random drawing: a line, or a circle.
fn entity(kind: bool, [x, y, u, v]: [f64; 4]) -> String {
    if kind {
        format!("0 CIRCLE\n8 Cut\n10 {x}\n20 {y}\n40 {}\n", 0.1 + u / 10.0)
    } else {
        format!("0 LINE\n8 Cut\n10 {x}\n20 {y}\n11 {u}\n21 {v}\n")
    }
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 40,
        rng_seed: RngSeed::Fixed(1),
        failure_persistence: None,
        ..ProptestConfig::default()
    })]

    /// On any drawing the analysis is no longer than the file order, and the default is no longer
    /// than the analysis.
    #[test]
    fn no_order_is_longer_than_the_one_of_the_file(
        entities in prop::collection::vec(
            (any::<bool>(), prop::array::uniform4(0.0..100.0)), 1..50),
        passes in 1..4_u8,
        rows in any::<bool>(),
    ) {
        let text: String = entities.iter().enumerate().map(|(k, &(kind, at))| {
            // Rows from the origin in turns: the file order is already a short one.
            let y = k as f64;
            let (from, to) = if k % 2 == 0 { (0.0, 90.0) } else { (90.0, 0.0) };
            if rows { entity(false, [from, y, to, y]) } else { entity(kind, at) }
        }).collect();
        let drawing = drawing(&dxf(&text));
        let air = [Ordering::File, Ordering::Greedy, Ordering::Short].map(|ordering| {
            let options = Options {
                ordering,
                depth_mm: f64::from(passes),
                step_mm: 1.0,
                ..Options::default()
            };
            plan(&drawing, &options).unwrap().toolpath.lengths([0.0; 2]).air_mm
        });
        prop_assert!(air[1] <= air[0] + 1e-6 && air[2] <= air[1] + 1e-6, "{air:?}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 60,
        rng_seed: RngSeed::Fixed(1),
        failure_persistence: None,
        ..ProptestConfig::default()
    })]

    /// On any drawing the default has no longer air than each order that is shown beside it, as
    /// cut: several passes, ramps on closed paths, lines that join into chains.
    #[test]
    fn the_default_is_the_shortest_of_all_orders(
        entities in prop::collection::vec(
            (any::<bool>(), prop::array::uniform4(0.0..100.0)), 1..60),
        passes in 1..4_u8,
        ramp in any::<bool>(),
        coarse in any::<bool>(),
    ) {
        let text: String = entities.iter().map(|&(kind, at)| {
            let at = if coarse { at.map(|value: f64| (value / 20.0).round() * 20.0) } else { at };
            entity(kind || at[..2] == at[2..], at)
        }).collect();
        let options = Options {
            depth_mm: f64::from(passes),
            step_mm: 1.0,
            ramp_deg: ramp.then_some(10.0),
            ..Options::default()
        };
        let job = plan(&drawing(&dxf(&text)), &options).unwrap();
        let air = job.toolpath.lengths([0.0; 2]).air_mm;
        prop_assert_eq!(job.candidates.len(), 6);
        for one in &job.candidates {
            prop_assert!(air <= one.lengths.air_mm + 1e-6, "{air} {one:?}");
        }
    }
}

/// The default beside the greedy conditions on a drawing of more than 3,000 entities.
#[test]
fn large_drawings_are_compared_with_the_greedy_orders_too() {
    let mut state = 1_u64;
    let mut next = || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f64 / 16_777.216
    };
    let lines: Vec<[Point; 2]> = (0..3_500)
        .map(|_| {
            let at = [next(), next()];
            [at, [at[0] + 3.0, at[1]]]
        })
        .collect();
    let job = plan(&lines_dxf(&lines), &Options::default()).unwrap();
    assert_eq!(job.candidates.len(), 6);
    let air = job.toolpath.lengths([0.0; 2]).air_mm;
    assert!(
        job.candidates
            .iter()
            .all(|one| air <= one.lengths.air_mm + 1e-6)
    );
}

/// A ramp ends beside the start of a closed path. From where this circle starts in the file the way
/// to it and from it is the shortest.
#[test]
fn the_way_from_the_end_of_a_ramp_counts() {
    let text = dxf("0 CIRCLE\n8 Cut\n10 -48\n20 -13.8\n40 10\n");
    let options = Options {
        depth_mm: 1.0,
        ramp_deg: Some(10.0),
        ..Options::default()
    };
    let job = plan(&drawing(&text), &options).unwrap();
    let air = job.toolpath.lengths([0.0; 2]).air_mm;
    let file = job.candidates[0].lengths.air_mm;
    assert!(air <= file + 1e-9, "{air} {file}");
}

/// Squares as closed polylines or as lines, each with a diagonal from a corner or from elsewhere.
fn square_with_diagonal([x, y, side, kind]: [f64; 4]) -> String {
    let (x, y, side) = (x.round(), y.round(), 1.0 + side.round());
    let (u, v) = (x + side, y + side);
    let square = if kind < 0.6 {
        format!(
            "0 LWPOLYLINE\n8 Cut\n90 4\n70 1\n10 {x}\n20 {y}\n10 {u}\n20 {y}\n10 {u}\n20 {v}\n10 {x}\n20 {v}\n"
        )
    } else {
        let corners = [[x, y], [u, y], [u, v], [x, v], [x, y]];
        let sides = corners.windows(2);
        sides
            .map(|pair| {
                let [[a, b], [c, d]] = [pair[0], pair[1]];
                format!("0 LINE\n8 Cut\n10 {a}\n20 {b}\n11 {c}\n21 {d}\n")
            })
            .collect()
    };
    let from = if kind * 10.0 % 1.0 < 0.7 { x } else { x + 0.5 };
    format!("{square}0 LINE\n8 Cut\n10 {from}\n20 {y}\n11 {u}\n21 {v}\n")
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 80,
        rng_seed: RngSeed::Fixed(1),
        failure_persistence: None,
        ..ProptestConfig::default()
    })]

    /// The job takes no more time in the default order than in each other one, and the tool does
    /// not come up and down again at one point in it.
    #[test]
    fn the_default_takes_no_more_time_than_any_order(
        shapes in prop::collection::vec((
            prop::array::uniform4(0.0..90.0), 0.0..9.0, 0.0..1.0), 1..14),
        passes in 1..4_u8,
        ramp in any::<bool>(),
        plunge in prop::sample::select(vec![0.1, 1.0, 4.0]),
    ) {
        let text: String = shapes.iter()
            .map(|&([x, y, ..], side, kind)| square_with_diagonal([x, y, side, kind])).collect();
        let options = Options {
            depth_mm: f64::from(passes),
            step_mm: 1.0,
            ramp_deg: ramp.then_some(10.0),
            speeds: Speeds { plunge, ..Speeds::default() },
            ..Options::default()
        };
        let drawing = drawing(&dxf(&text));
        let job = plan(&drawing, &options).unwrap();
        let time = |lengths: &Lengths| Times::of(lengths, &options.speeds).total();
        let chosen = job.toolpath.lengths([0.0; 2]);
        for one in &job.candidates {
            prop_assert!(time(&chosen) <= time(&one.lengths) + 1e-6, "{chosen:?} {one:?}");
        }
        // The geometry is that of the file, apart from ramps.
        if !ramp {
            prop_assert!((chosen.cut_mm - job.candidates[0].lengths.cut_mm).abs() < 1e-6);
        }
        if passes == 1 && !ramp {
            for pair in job.toolpath.cuts.windows(2) {
                let (end, start) = (pair[0].end(), pair[1].start);
                let gap = (end[0] - start[0]).hypot(end[1] - start[1]);
                prop_assert!(gap > 0.0025, "{end:?} {start:?}");
            }
        }
    }
}

/// A closed square and its diagonal are one cut, in any number of passes and with tabs.
#[test]
fn paths_that_meet_are_cut_without_a_lift() {
    let drawing = drawing(&dxf(&square_with_diagonal([10.0, 10.0, 7.0, 0.0])));
    for passes in 1..5_u8 {
        for tabs in [
            None,
            Some(Tabs {
                count: 2,
                width_mm: 1.0,
                height_mm: 0.2,
            }),
        ] {
            let options = Options {
                depth_mm: f64::from(passes),
                step_mm: 1.0,
                tabs,
                ..Options::default()
            };
            let (job, _) = match tabs {
                None => check(&drawing, &options),
                Some(_) => (plan(&drawing, &options).unwrap(), PlateReport::default()),
            };
            assert_eq!(job.toolpath.cuts.len(), 1, "{passes} {tabs:?}");
            let air = job.toolpath.lengths([0.0; 2]).air_mm;
            let both_ends = if passes % 2 == 0 { 20.0 } else { 28.0 };
            assert!((air - both_ends * 2.0_f64.sqrt()).abs() < 1e-9, "{air}");
        }
    }
}
