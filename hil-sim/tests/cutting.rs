//! Material removal: what the mill removes, and where it finds material.

use crate::mill;
use haptimill_hil_sim::process::{Coefficients, ToolPose};
use mill::{Bench, TURN, block, config, largest, mean, peaks, with_slot};
use std::f64::consts::PI;

const R: f64 = 4.0;

/// Returns the area of the slot's cross-section: a circular segment, and above the ball the width
/// of the shank.
fn section(depth: f64) -> f64 {
    let ball = depth.min(R);
    let half = ((R - ball) / R).acos();
    R * R * (half - half.sin() * half.cos()) + (depth - ball) * 2.0 * R
}

/// Returns the volume of the ball (and shank) below the surface.
fn pit(depth: f64) -> f64 {
    let ball = depth.min(R);
    PI * ball * ball * (R - ball / 3.0) + PI * R * R * (depth - ball)
}

#[test]
fn removed_volume_is_the_sweep_of_the_ball() {
    for depth in [1.0, 2.0, 3.0, 5.0] {
        let mut bench = with_slot(10.0, depth);
        bench.cutting.settle();
        let exact = pit(depth) + 20.0 * section(depth);
        let ours = bench.cutting.workpiece().removed_mm3();
        // Vertical walls are accurate to half a cell per side.
        let tolerance = if depth > R { 0.003 } else { 0.0005 };
        assert!(
            (ours / exact - 1.0).abs() < tolerance,
            "{depth}: {ours}, {exact}"
        );
    }
}

#[test]
fn chip_volume_equals_the_volume_that_the_map_loses() {
    for (depth, feed) in [(1.0, 4.0), (2.0, 4.0), (2.0, 10.0), (5.0, 4.0)] {
        let mut bench = with_slot(feed, depth);
        // Away from the plunge, over many whole revolutions.
        let before = bench.cutting.chips_mm3();
        bench.line([-24.0, 0.0, -depth], feed);
        let chips = bench.cutting.chips_mm3() - before;
        let exact = 4.0 * section(depth);
        assert!(
            (chips / exact - 1.0).abs() < 0.01,
            "{depth} mm, {feed} mm/s: {chips} mm3 of chips, {exact} mm3 of slot"
        );
    }
}

#[test]
fn a_tool_in_air_has_no_force() {
    let config = config(block(-26.0, 6.0, -6.0, 6.0), Coefficients::P1);
    let mut bench = Bench::new(&config, [0.0, 0.0, 0.001]);
    let cuts = bench.line([-20.0, 3.0, 0.001], 20.0);
    assert!(cuts.iter().all(|cut| cut.force == [0.0; 3] && !cut.engaged));
    assert_eq!(bench.cutting.workpiece().removed_mm3(), 0.0);
    assert_eq!(bench.cutting.chips_mm3(), 0.0);
}

#[test]
fn a_second_pass_removes_nothing() {
    for (depth, feed) in [(2.0, 4.0), (3.5, 2.0), (5.0, 4.0)] {
        let mut bench = with_slot(feed, depth);
        let first = bench.line([-20.5, 0.0, -depth], feed);
        // Back along the slot, out at its start, and once more.
        let back = bench.line([0.0, 0.0, -depth], feed);
        let volume = bench.cutting.workpiece().removed_mm3();
        let chips = bench.cutting.chips_mm3();
        let again = bench.line([-20.0, 0.0, -depth], feed);
        assert!(largest(&first) > 3.0);
        // The way back finishes the last tooth's chip. At the ends of the slot, steep walls are met
        // up to 0.3 mm too early.
        let ends = (0.4 / (feed * mill::PERIOD)) as usize;
        let middle =
            |cuts: &[haptimill_hil_sim::process::Cut]| largest(&cuts[ends..cuts.len() - ends]);
        assert_eq!(middle(&back), 0.0, "{depth} back");
        assert_eq!(middle(&again), 0.0, "{depth} again");
        if depth < 3.0 {
            assert_eq!(largest(&back[2 * ends..]), 0.0);
            assert_eq!(largest(&again), 0.0);
            assert_eq!(bench.cutting.chips_mm3(), chips);
        }
        bench.cutting.settle();
        let more = bench.cutting.workpiece().removed_mm3() - volume;
        assert!(more.abs() < 1e-3 * volume, "{more} of {volume}");
    }
}

#[test]
fn a_stopped_feed_has_no_force_and_continues_as_before() {
    let mut bench = with_slot(4.0, 2.0);
    let running = bench.line([-21.0, 0.0, -2.0], 4.0);
    let standing = bench.stand(20 * TURN);
    assert!(
        largest(&standing[2 * TURN..]) < 1e-9,
        "no chip without feed"
    );
    let again = bench.line([-22.0, 0.0, -2.0], 4.0);
    let (was, is) = (mean(&running, 8), mean(&again, 8));
    for i in 0..3 {
        assert!((was[i] - is[i]).abs() < 0.01 * was[0], "{was:?} {is:?}");
    }
    // The tool retracts slowly by 0.3 mm and moves on. It meets only air until the old place, to
    // less than the shank's tolerance.
    let back = bench.line([-21.7, 0.0, -2.0], 1.0);
    assert_eq!(largest(&back[2 * TURN..]), 0.0);
    let air = bench.line([-21.99, 0.0, -2.0], 1.0);
    assert_eq!(largest(&air), 0.0);
    let fresh = bench.line([-22.3, 0.0, -2.0], 1.0);
    assert!(largest(&fresh[4 * TURN..]) > 1.0);
}

#[test]
fn forces_repeat_with_the_teeth() {
    let mut bench = with_slot(4.0, 2.0);
    let cuts = bench.line([-21.0, 0.0, -2.0], 4.0);
    let (high, _) = peaks(&cuts, 10);
    let tail = &cuts[cuts.len() - 4 * TURN..];
    for (now, later) in tail.iter().zip(&tail[TURN / 2..]) {
        for i in 0..3 {
            assert!((now.force[i] - later.force[i]).abs() < 0.01 * high[0]);
        }
    }
    // Within a tooth the forces change.
    let (high, low) = peaks(&cuts, 10);
    assert!(high[0] - low[0] > 3.0);
    // One tooth alone does half the work, once per revolution.
    let mut config = config(block(-26.0, 6.0, -6.0, 6.0), Coefficients::P2);
    config.cutter.teeth = 1;
    let mut one = Bench::new(&config, [0.0, 0.0, 1.0]);
    one.line([0.0, 0.0, -2.0], 4.0);
    let single = one.line([-3.0, 0.0, -2.0], 4.0);
    config.cutter.teeth = 2;
    let mut two = Bench::new(&config, [0.0, 0.0, 1.0]);
    two.line([0.0, 0.0, -2.0], 4.0);
    let double = two.line([-3.0, 0.0, -2.0], 4.0);
    // The same material is removed per revolution, so without edge forces the mean force is equal.
    let (single, double) = (mean(&single, 8), mean(&double, 8));
    for i in 0..3 {
        assert!(
            (single[i] - double[i]).abs() < 0.01 * double[0],
            "{single:?} {double:?}"
        );
    }
}

#[test]
fn force_grows_with_feed_and_scale() {
    // Without edge forces the force is proportional to the feed.
    let force = |feed: f64, scale: f64| {
        let mut config = config(block(-26.0, 6.0, -6.0, 6.0), Coefficients::P2);
        config.cutter.force_scale = scale;
        let mut bench = Bench::new(&config, [0.0, 0.0, 1.0]);
        bench.line([0.0, 0.0, -2.0], 4.0);
        mean(&bench.line([-3.0, 0.0, -2.0], feed), 8)
    };
    let (slow, fast, strong) = (force(2.0, 1.0), force(8.0, 1.0), force(2.0, 3.0));
    for i in 0..3 {
        assert!((fast[i] / slow[i] - 4.0).abs() < 0.03, "{slow:?} {fast:?}");
        assert!((strong[i] / slow[i] - 3.0).abs() < 1e-12);
    }
    assert!(slow[0] > 0.0 && slow[1] < 0.0 && slow[2] > 0.0, "-x: + - +");
}

#[test]
fn the_spindle_speed_sets_the_chip_thickness() {
    let mut bench = with_slot(4.0, 2.0);
    let full = mean(&bench.line([-21.0, 0.0, -2.0], 4.0), 8);
    // Half the speed is twice the feed per tooth. P1 has edge forces, so the force is a little less
    // than double.
    bench.rpm = 2500.0;
    let half = mean(&bench.line([-22.5, 0.0, -2.0], 4.0), 8);
    let twice = mean(&with_slot(8.0, 2.0).line([-21.5, 0.0, -2.0], 8.0), 8);
    for i in 0..3 {
        assert!(
            (half[i] - twice[i]).abs() < 0.02 * twice[0],
            "{half:?} {twice:?}"
        );
        assert!(half[i].abs() > 1.2 * full[i].abs());
    }
}

/// A pass beside a slot, 2 mm aside. Feed +x with the material on the -y side is down milling with
/// this spindle, feed -x is up milling. (docs/control.md 5.2: the passes of the pocket have Fx + -
/// +, the second the smallest.)
#[test]
fn up_and_down_milling_forces_have_the_right_signs() {
    let config = config(block(-36.0, 6.0, -11.0, 6.0), Coefficients::P1);
    let mut bench = Bench::new(&config, [0.0, 0.0, 1.0]);
    bench.line([0.0, 0.0, -2.0], 4.0);
    let signed = |cuts: &[haptimill_hil_sim::process::Cut]| {
        let (high, low) = peaks(cuts, 8);
        core::array::from_fn::<f64, 3, _>(|i| if high[i] > -low[i] { high[i] } else { low[i] })
    };
    bench.line([-28.0, 0.0, -2.0], 4.0);
    let first = signed(&bench.line([-30.0, 0.0, -2.0], 4.0));
    bench.line([-30.0, -2.0, -2.0], 1.0);
    bench.line([-10.0, -2.0, -2.0], 4.0);
    let second = signed(&bench.line([-8.0, -2.0, -2.0], 4.0));
    bench.line([0.0, -2.0, -2.0], 4.0);
    bench.line([0.0, -4.0, -2.0], 1.0);
    bench.line([-20.0, -4.0, -2.0], 4.0);
    let third = signed(&bench.line([-22.0, -4.0, -2.0], 4.0));
    // The model of docs/control.md: +5.6 / -2.2 / +5.6 in x; negative, positive, positive in y.
    assert!((first[0] - 5.6).abs() < 0.15, "{first:?}");
    assert!((second[0] + 2.2).abs() < 0.4, "{second:?}");
    assert!((third[0] - 5.6).abs() < 0.4, "{third:?}");
    assert!(
        first[1] < 0.0 && second[1] > 0.0 && third[1] > 0.0,
        "{first:?} {second:?} {third:?}"
    );
    println!("{first:?} {second:?} {third:?}");
}

#[test]
fn force_starts_and_ends_at_the_edges_of_the_stock() {
    let mut piece = block(-10.0, 10.0, -6.0, 6.0);
    piece.stock.x_min = -5.0;
    piece.stock.x_max = 5.0;
    let mut bench = Bench::new(&config(piece, Coefficients::P1), [9.5, 0.0, -2.0]);
    let cuts = bench.line([-9.6, 0.0, -2.0], 4.0);
    // The ball's radius at the surface is 3.46 mm: its front touches first at x = 5.
    let half = (2.0 * R * 2.0 - 4.0_f64).sqrt();
    let place = |step: usize| 9.5 - (step + 1) as f64 * 4.0 * mill::PERIOD;
    let first = cuts.iter().position(|cut| cut.engaged).expect("cuts");
    let last = cuts.iter().rposition(|cut| cut.engaged).expect("cuts");
    assert!(
        (place(first) - (5.0 + half)).abs() < 0.1,
        "{}",
        place(first)
    );
    // The trailing half cuts nothing. The cut ends when the middle reaches the far edge, except for
    // the sides that are wider than the workpiece.
    assert!((place(last) - -5.0).abs() < 0.15, "{}", place(last));
    // The force rises and falls without a step larger than one tooth's.
    let full = peaks(&cuts[..cuts.len() / 2], 8).0[0];
    assert!(full > 5.0);
    let first_turns = &cuts[first..first + 2 * TURN];
    assert!(
        largest(first_turns) < 0.1 * full,
        "{}",
        largest(first_turns)
    );
    bench.cutting.settle();
    let exact = 10.0 * section(2.0);
    let ours = bench.cutting.workpiece().removed_mm3();
    assert!((ours / exact - 1.0).abs() < 0.01, "{ours} {exact}");
}

#[test]
fn an_incline_is_cut_deeper_along_the_path() {
    let mut piece = block(-27.0, 7.0, -6.0, 6.0);
    piece.rise_x_deg = -10.0;
    let mut bench = Bench::new(&config(piece, Coefficients::P2), [0.0, 0.0, 3.0]);
    // 1 mm deep at x = 0; 4.53 mm at x = -20 (experiment E3).
    bench.line([0.0, 0.0, -1.0], 4.0);
    let cuts = bench.line([-20.0, 0.0, -1.0], 2.0);
    let mut before = 0.0;
    for part in cuts.chunks(cuts.len() / 10) {
        let now = peaks(part, 4).0[0];
        assert!(now > before, "{now} after {before}");
        before = now;
    }
    bench.cutting.settle();
    let groove = bench
        .cutting
        .workpiece()
        .groove([-20.0, -6.0], [-20.0, 6.0], 0.1)
        .expect("a groove");
    let depth = 1.0 + 20.0 * (10.0_f64 * PI / 180.0).tan();
    assert!((groove.depth - depth).abs() < 1e-3, "{groove:?} {depth}");
    assert!((groove.width() - 8.0).abs() < 0.1, "{groove:?}");
    assert!((groove.middle() - 6.0).abs() < 0.01);
}

#[test]
fn a_tilted_tool_removes_the_same_volume() {
    // With a tilt of 20 degrees about x (alpha) and feed along x the ball sweeps the same slot; the
    // edges meet it elsewhere.
    let config = config(block(-26.0, 6.0, -6.0, 6.0), Coefficients::P2);
    let run = |alpha: f64| {
        let start = ToolPose::leaning([0.0, 0.0, 5.0], 0.0, alpha);
        let mut cutting =
            haptimill_hil_sim::process::Cutting::new(&config, &start).expect("a mill");
        let mut chips = 0.0;
        let mut force = [0.0; 3];
        let steps = 20_000;
        for step in 0..steps {
            let x = -(step as f64) * 4.0 * mill::PERIOD;
            // The centre moves at the same height for every tilt.
            let centre = [x, 0.0, R - 2.0];
            let tip = core::array::from_fn(|i| centre[i] - R * start.axis[i]);
            let pose = ToolPose { tip, ..start };
            if step == 0 {
                cutting.place(&pose);
            }
            if step == steps / 2 {
                chips = cutting.chips_mm3();
            }
            let cut = cutting.step(&pose, mill::RPM / 60.0 * mill::PERIOD);
            if step >= steps - 10 * TURN {
                for (sum, part) in force.iter_mut().zip(cut.force) {
                    *sum += part / (10 * TURN) as f64;
                }
            }
        }
        (cutting.chips_mm3() - chips, force)
    };
    let exact = 8.0 * section(2.0);
    for alpha in [0.0, 20.0, -20.0] {
        let (chips, force) = run(alpha);
        assert!(
            (chips / exact - 1.0).abs() < 0.01,
            "{alpha}: {chips} {exact}"
        );
        assert!(force[0] > 0.0, "{alpha}: {force:?}");
    }
}

#[test]
fn a_stopped_spindle_presses_until_the_tool_retracts() {
    let mut bench = with_slot(4.0, 2.0);
    let cutting = largest(&bench.line([-20.5, 0.0, -2.0], 4.0));
    bench.rpm = 0.0;
    let volume = bench.cutting.workpiece().removed_mm3();
    let pressed = bench.line([-21.5, 0.0, -2.0], 4.0);
    let last = pressed.last().expect("a step");
    assert!(
        last.pressed && last.force[0] > 10.0 * cutting,
        "{last:?} {cutting}"
    );
    // The force grows all the way.
    let quarter = pressed.len() / 4;
    for pair in pressed.chunks(quarter).collect::<Vec<_>>().windows(2) {
        assert!(pair[1][0].force[0] > pair[0][0].force[0]);
    }
    assert_eq!(
        bench.cutting.workpiece().removed_mm3(),
        volume,
        "nothing is cut"
    );
    // The tool retracts along its path and is free where it cut last.
    let back = bench.line([-20.0, 0.0, -2.0], 4.0);
    assert!(
        back.last()
            .is_some_and(|cut| cut.force == [0.0; 3] && !cut.pressed)
    );
    // With the spindle on, it continues from there.
    bench.rpm = mill::RPM;
    let air = bench.line([-20.4, 0.0, -2.0], 4.0);
    assert_eq!(largest(&air[5 * TURN..]), 0.0);
    let again = bench.line([-22.0, 0.0, -2.0], 4.0);
    let (high, _) = peaks(&again, 8);
    assert!((high[0] / cutting - 1.0).abs() < 0.05, "{high:?} {cutting}");
}

#[test]
fn jogging_with_the_spindle_off_cuts_nothing() {
    let config = config(block(-26.0, 6.0, -6.0, 6.0), Coefficients::P1);
    let mut bench = Bench::new(&config, [4.0, -4.0, 5.0]);
    bench.stand(200);
    bench.rpm = 0.0;
    // Around and back to a place above another point; nothing on the straight line between may be
    // cut.
    bench.line([4.0, 4.0, 0.5], 50.0);
    bench.line([-20.0, 4.0, 0.5], 50.0);
    bench.rpm = mill::RPM;
    let cuts = bench.line([-20.0, 4.0, 0.2], 1.0);
    assert_eq!(largest(&cuts), 0.0);
    bench.cutting.settle();
    assert_eq!(bench.cutting.workpiece().removed_mm3(), 0.0);
}

#[test]
fn the_same_cut_gives_the_same_bits() {
    let run = || {
        let mut bench = with_slot(7.3, 2.2);
        let cuts = bench.line([-23.0, 1.7, -1.4], 3.1);
        let bits: Vec<u64> = cuts
            .iter()
            .flat_map(|cut| cut.force)
            .map(f64::to_bits)
            .collect();
        let heights: Vec<u32> = bench
            .cutting
            .workpiece()
            .heights()
            .iter()
            .map(|height| height.to_bits())
            .collect();
        (bits, heights)
    };
    assert!(run() == run());
}
