//! What the thesis states of its programmed cuts on flat work: E1, E2, E7, E9, E11.

use super::Cut;
use super::course::{Course, Sample, largest, mean, smallest};
use super::stated::{Claim, Source, measured};

use Source::{Derived, Own, Stated};

/// Depth at which grooves are measured below the uncut top, mm: clear of the corner, which the height map rounds off.
const LEVEL: f64 = 0.2;

/// Radius of the mill, mm.
const RADIUS: f64 = 4.0;

/// Seconds that are left out behind the start and before the end of a motion where a settled value is meant.
const SETTLING: f64 = 0.3;

/// Half the width of what a ball leaves at [`LEVEL`] in a groove of this depth, mm.
fn half_width(depth: f64) -> f64 {
    let above_centre = RADIUS - (depth - LEVEL);
    (RADIUS * RADIUS - above_centre * above_centre).sqrt()
}

/// Samples of the way that a condition holds for.
fn where_(way: &[Sample], condition: impl Fn(&Sample) -> bool) -> Vec<Sample> {
    way.iter()
        .filter(|sample| condition(sample))
        .copied()
        .collect()
}

/// The same without the first moments and the last, in which the tool slows down.
fn settled(samples: &[Sample]) -> &[Sample] {
    let (Some(first), Some(last)) = (samples.first(), samples.last()) else {
        return samples;
    };
    let begins = samples.partition_point(|sample| sample.time < first.time + SETTLING);
    let ends = samples.partition_point(|sample| sample.time < last.time - SETTLING);
    &samples[begins..ends.max(begins)]
}

/// Tool against the program in x and y, largest in either, after the start.
fn tool_error(course: &Course) -> Claim {
    let way = course.way();
    let error = largest(settled(&way), |sample| {
        let off = |axis: usize| (sample.tool[axis] - sample.desired[axis]).abs();
        off(0).max(off(1))
    });
    measured(
        "tool against program in X and Y, largest",
        "\"close\", no number",
        error,
        "mm",
    )
    .at_most(0.25, Derived)
}

const MODEL_IS_STEADY: &str = "the thesis's force falls after the step of feed (5 N before the next one), the model's is as large as the chip is thick: \
     proportional to feed, without a transient";

/// E1.
pub(super) fn feed_sweep(cuts: &[Cut]) -> Vec<Claim> {
    let [cut] = cuts else { return Vec::new() };
    let course = &cut.course;
    let way = course.way();
    let (first, second, third) = (
        course.between(0.0, 3.0),
        course.between(3.0, 6.0),
        course.between(6.0, 9.0),
    );
    let fx = |sample: &Sample| sample.high[0];
    let moving = settled(&way);
    vec![
        tool_error(course),
        measured("Fx high at 2 mm/s, before 3 s", "3 N", mean(settled(first), fx), "N").within(
            2.0, 4.0, Derived,
        ),
        measured("Fx high, peak after 3 s (6 mm/s)", "7 N", largest(second, fx), "N").within(
            5.0, 9.0, Derived,
        ),
        measured(
            "Fx high before 6 s (6 mm/s, settled)",
            "5 N",
            mean(course.between(5.0, 5.9), fx),
            "N",
        )
        .within(3.5, 6.5, Derived)
        .because(MODEL_IS_STEADY),
        measured("Fx high, peak after 6 s (10 mm/s)", "12 N", largest(third, fx), "N").within(
            9.0, 15.0, Derived,
        ),
        measured("Fx high, smallest on the way", "always +", smallest(moving, fx), "N")
            .at_least(0.0, Stated),
        measured(
            "Fx low, largest magnitude",
            "at most 4 N",
            largest(moving, |sample| sample.low[0].abs()),
            "N",
        )
        .at_most(4.0, Stated),
        measured(
            "Fy high, largest (sign)",
            "-",
            largest(moving, |sample| sample.high[1]),
            "N",
        )
        .at_most(0.0, Stated),
        measured(
            "Fy high, growth of the magnitude from 2 to 10 mm/s",
            "grows with feed",
            mean(settled(first), |s| s.high[1]) - mean(settled(third), |s| s.high[1]),
            "N",
        )
        .at_least(0.5, Derived),
        measured(
            "Fy low at 10 mm/s, magnitude",
            "2 N",
            mean(settled(third), |sample| sample.low[1].abs()),
            "N",
        )
        .within(1.0, 3.0, Derived)
        .because(LOW_FY),
        measured("Fz high, smallest", "3 to 7 N", smallest(moving, |s| s.high[2]), "N")
            .within(3.0, 7.0, Stated)
            .because(THIN),
        measured("Fz high, largest", "3 to 7 N", largest(moving, |s| s.high[2]), "N")
            .within(3.0, 7.0, Stated)
            .because("the fitted model gives 7.3 N at 10 mm/s in the steady state (docs/control.md 5.2), the thesis a range for the whole run"),
        measured(
            "Fz low, largest magnitude",
            "0",
            largest(moving, |sample| sample.low[2].abs()),
            "N",
        )
        .at_most(1.0, Derived)
        .because(LOW_FZ),
    ]
}

const THIN: &str = "at 2 mm/s much of the tip's chip is thinner than 6 um, where the plant's edges press with a part of their force only";
const LOW_FY: &str = "the coefficients were fitted to the high forces; in the model Fy of a tooth turns its sign on the way through the slot, and what it is where the tooth \
     enters is the low force. The thesis does not say how its low forces were taken";
const LOW_FZ: &str = "with two flutes in a slot, a part of one is always in the cut: the model's Fz never falls to nothing, and the less so the faster the feed. The thesis does \
     not say how its low forces were taken";

/// E2.
pub(super) fn depth_sweep(cuts: &[Cut]) -> Vec<Claim> {
    let [cut] = cuts else { return Vec::new() };
    let way = cut.course.way();
    let at = |depth: f64| {
        let z = 21.232 - depth;
        let pass = where_(&way, |sample| (sample.desired[2] - z).abs() < 0.005);
        settled(&pass).to_vec()
    };
    let [one, three, five] = [at(1.0), at(3.0), at(5.0)];
    let fx = |pass: &[Sample]| mean(pass, |sample| sample.high[0]);
    let fy = |pass: &[Sample]| mean(pass, |sample| sample.high[1].abs());
    let fz = |pass: &[Sample]| mean(pass, |sample| sample.high[2]);
    let all: Vec<Sample> = [&one[..], &three, &five].concat();
    vec![
        tool_error(&cut.course),
        measured(
            "Fx high: growth from 1 to 3 mm",
            "grows with depth",
            fx(&three) - fx(&one),
            "N",
        )
        .at_least(0.5, Derived),
        measured(
            "Fx high: growth from 3 to 5 mm",
            "grows with depth",
            fx(&five) - fx(&three),
            "N",
        )
        .at_least(0.5, Derived),
        measured(
            "Fx high, smallest",
            "+",
            smallest(&all, |sample| sample.high[0]),
            "N",
        )
        .at_least(0.0, Stated),
        measured(
            "Fx low, largest magnitude",
            "at most 4 N",
            largest(&all, |sample| sample.low[0].abs()),
            "N",
        )
        .at_most(4.0, Stated),
        measured(
            "Fy high, largest (sign)",
            "-",
            largest(&all, |sample| sample.high[1]),
            "N",
        )
        .at_most(0.0, Stated),
        measured(
            "Fy high: growth of the magnitude from 1 to 5 mm",
            "grows with depth",
            fy(&five) - fy(&one),
            "N",
        )
        .at_least(0.5, Derived),
        measured(
            "Fy low at 5 mm, magnitude",
            "1 to 3 N",
            mean(&five, |sample| sample.low[1].abs()),
            "N",
        )
        .within(1.0, 3.0, Stated)
        .because(LOW_FY),
        measured("Fz high at 1 mm", "3 to 7 N", fz(&one), "N")
            .within(3.0, 7.0, Stated)
            .because(SHALLOW),
        measured("Fz high at 3 mm", "3 to 7 N", fz(&three), "N")
            .within(3.0, 7.0, Stated)
            .because(SHALLOW),
        measured("Fz high at 5 mm", "3 to 7 N", fz(&five), "N")
            .within(3.0, 7.0, Stated)
            .because(EQUATOR),
        measured(
            "Fz high: 5 mm less the larger of 1 and 3 mm",
            "largest at 5 mm",
            fz(&five) - fz(&one).max(fz(&three)),
            "N",
        )
        .at_least(0.0, Stated)
        .because(EQUATOR),
    ]
}

const SHALLOW: &str = "the coefficients were fitted at a depth of 2 mm (docs/control.md 5.2), where an edge presses in full at once; at 2 mm/s much of the tip's chip is thinner than 6 um, where the \
     plant's edges press with a part of their force only. The thesis gives one range for all depths";
const EQUATOR: &str = "at 5 mm the cut reaches above the equator of the ball (4 mm), where the helix pulls the tool down: the model's Fz falls there. The thesis's oscillation at \
     this depth is not in the model either";

/// E7.
pub(super) fn slot(cuts: &[Cut]) -> Vec<Claim> {
    let [cut] = cuts else { return Vec::new() };
    let way = cut.course.way();
    let moving = settled(&way);
    let work = &cut.work;
    let across = |x: f64| work.groove([x, -8.0], [x, 8.0], LEVEL);
    let sections: Vec<_> = [-5.0, -15.0, -25.0].into_iter().map(across).collect();
    let worst = |value: &dyn Fn(usize) -> f64| (0..sections.len()).map(value).fold(0.0, f64::max);
    let width = worst(&|i| {
        sections[i].map_or(f64::NAN, |groove| {
            (groove.width() - 2.0 * half_width(2.0)).abs()
        })
    });
    let depth = worst(&|i| sections[i].map_or(f64::NAN, |groove| (groove.depth - 2.0).abs()));
    let length = work.extents(LEVEL).map_or(f64::NAN, |area| {
        area.x_max - area.x_min - 2.0 * half_width(2.0)
    });
    vec![
        tool_error(&cut.course),
        measured(
            "duration of the way",
            "7.5 s",
            way.last().map_or(f64::NAN, |sample| sample.time),
            "s",
        )
        .within(7.4, 7.8, Derived),
        measured(
            "length of the slot, between the centres of its ends",
            "30 mm",
            length,
            "mm",
        )
        .within(29.9, 30.1, Own),
        measured(
            "width of the slot against the sweep of the tool, worst of 3 sections",
            "",
            width,
            "mm",
        )
        .at_most(0.1, Own),
        measured(
            "depth of the slot against the sweep of the tool, worst of 3 sections",
            "2 mm deep",
            depth,
            "mm",
        )
        .at_most(0.1, Own),
        measured("Fx high", "+6 N", mean(moving, |s| s.high[0]), "N").within(4.0, 8.0, Derived),
        measured(
            "Fx high, peak",
            "above 5 N",
            largest(moving, |s| s.high[0]),
            "N",
        )
        .at_least(5.0, Stated),
        measured(
            "Fy high, largest (sign)",
            "-",
            largest(moving, |s| s.high[1]),
            "N",
        )
        .at_most(0.0, Stated),
        measured(
            "Fy high, largest magnitude",
            "at most 6 N",
            largest(moving, |s| s.high[1].abs()),
            "N",
        )
        .at_most(6.0, Stated),
        measured(
            "Fz high, smallest",
            "+",
            smallest(moving, |s| s.high[2]),
            "N",
        )
        .at_least(0.0, Stated),
        measured(
            "Fz high, largest",
            "at most 6 N",
            largest(moving, |s| s.high[2]),
            "N",
        )
        .at_most(6.0, Stated),
    ]
}

/// E9.
pub(super) fn pocket(cuts: &[Cut]) -> Vec<Claim> {
    let [cut] = cuts else { return Vec::new() };
    let course = &cut.course;
    let way = course.way();
    let pass = |y: f64| {
        where_(&way, |sample| {
            (sample.desired[1] - y).abs() < 1e-4 && sample.moves[0]
        })
    };
    let [first, second, third] = [pass(0.0), pass(-2.0), pass(-4.0)];
    let steps = where_(&way, |sample| sample.moves[1]);
    let fx = |pass: &[Sample]| mean(settled(pass), |sample| sample.high[0]);
    let fy = |pass: &[Sample]| mean(settled(pass), |sample| sample.high[1]);
    let fz = |pass: &[Sample]| mean(settled(pass), |sample| sample.high[2]);
    let later: Vec<Sample> = [settled(&second), settled(&third)].concat();
    let ends = |pass: &[Sample]| pass.last().map_or(f64::NAN, |sample| sample.time);
    let begins = |pass: &[Sample]| pass.first().map_or(f64::NAN, |sample| sample.time);
    let work = &cut.work;
    let section = work.groove([-15.0, -14.0], [-15.0, 10.0], LEVEL);
    let width = section.map_or(f64::NAN, |groove| {
        groove.width() - 4.0 - 2.0 * half_width(2.0)
    });
    let floor = [0.0, -2.0, -4.0]
        .into_iter()
        .map(|y| (work.depth(-15.0, y) - 2.0).abs())
        .fold(0.0, f64::max);
    let length = work.extents(LEVEL).map_or(f64::NAN, |area| {
        area.x_max - area.x_min - 2.0 * half_width(2.0)
    });
    vec![
        tool_error(course),
        measured("pass 1 ends at", "7.5 s", ends(&first), "s").within(7.0, 8.0, Derived),
        measured("pass 2 begins at", "9.5 s", begins(&second), "s").within(9.0, 10.0, Derived),
        measured("pass 2 ends at", "17 s", ends(&second), "s").within(16.5, 17.7, Derived),
        measured("pass 3 begins at", "19 s", begins(&third), "s").within(18.5, 19.9, Derived),
        measured("pass 3 ends at", "26.5 s", ends(&third), "s").within(26.0, 27.5, Derived),
        measured(
            "length of the pocket, between the centres of its ends",
            "30 mm",
            length,
            "mm",
        )
        .within(29.9, 30.1, Own),
        measured(
            "width of the pocket against the sweep of the tool",
            "",
            width.abs(),
            "mm",
        )
        .at_most(0.1, Own),
        measured(
            "depth under the three passes against the sweep",
            "2 mm deep",
            floor,
            "mm",
        )
        .at_most(0.1, Own),
        measured("Fx high in pass 1", "+6 N", fx(&first), "N").within(4.0, 8.0, Derived),
        measured("Fx high in pass 2", "-3 N", fx(&second), "N").within(-4.0, -2.0, Derived),
        measured("Fx high in pass 3", "+5 N", fx(&third), "N").within(3.3, 6.7, Derived),
        measured(
            "magnitude of Fx: pass 3 less pass 2",
            "above 0",
            fx(&third).abs() - fx(&second).abs(),
            "N",
        )
        .at_least(0.0, Derived),
        // Equal is allowed: to a code of the ADC.
        measured(
            "magnitude of Fx: pass 1 less pass 3",
            "not below 0 (to a code of the ADC)",
            fx(&first).abs() - fx(&third).abs(),
            "N",
        )
        .at_least(-0.012, Derived),
        measured(
            "Fx high in the steps along Y, largest",
            "at most +5 N",
            largest(&steps, |s| s.high[0]),
            "N",
        )
        .at_most(5.0, Stated)
        .because("the force of the pass before stays in the peak for one revolution"),
        measured("Fy high in pass 1", "-", fy(&first), "N").at_most(0.0, Stated),
        measured("Fy high in pass 2", "+", fy(&second), "N").at_least(0.0, Stated),
        measured("Fy high in pass 3", "+", fy(&third), "N").at_least(0.0, Stated),
        measured(
            "Fy high, largest magnitude",
            "at most 5 N",
            largest(settled(&way), |s| s.high[1].abs()),
            "N",
        )
        .at_most(5.0, Stated),
        measured("Fz high in pass 1", "5 N", fz(&first), "N").within(3.3, 6.7, Derived),
        measured(
            "Fz high in passes 2 and 3, smallest",
            "0 to 7 N",
            smallest(&later, |s| s.high[2]),
            "N",
        )
        .within(0.0, 7.0, Stated),
        measured(
            "Fz high in passes 2 and 3, largest",
            "0 to 7 N",
            largest(&later, |s| s.high[2]),
            "N",
        )
        .within(0.0, 7.0, Stated),
    ]
}

/// E11.
pub(super) fn circle(cuts: &[Cut]) -> Vec<Claim> {
    let [cut] = cuts else { return Vec::new() };
    let course = &cut.course;
    let way = course.way();
    let moving = settled(&way);
    // Speed along an axis from the circle: x = -15 + 15 cos wt, y = -15 sin wt.
    let speed = |sample: &Sample, axis: usize| match axis {
        0 => 4.0 / 15.0 * sample.desired[1],
        _ => -4.0 / 15.0 * (sample.desired[0] + 15.0),
    };
    let opposing = |axis: usize| {
        let fast = where_(moving, |sample| speed(sample, axis).abs() > 2.0);
        mean(&fast, |sample| {
            f64::from(sample.high[axis] * speed(sample, axis) < 0.0)
        })
    };
    let extreme = |axis: usize, sign: f64| {
        let key = |sample: &Sample| sign * sample.tool[axis];
        let best = moving.iter().max_by(|a, b| key(a).total_cmp(&key(b)));
        best.map_or(f64::NAN, |sample| sample.time)
    };
    let flip = where_(moving, |sample| {
        (6.0..18.0).contains(&sample.time) && sample.high[0] < 0.0
    });
    let ring = cut.work.ring(LEVEL, 360);
    let of = |value: &dyn Fn(&haptimill_hil_sim::process::metrology::Ring) -> f64| {
        ring.as_ref().map_or(f64::NAN, value)
    };
    vec![
        tool_error(course),
        measured(
            "size of the cut circle in X",
            "30 mm",
            of(&|ring| ring.extent_x),
            "mm",
        )
        .within(29.5, 30.5, Derived),
        measured(
            "size of the cut circle in Y",
            "29.5 mm (wanted 30)",
            of(&|ring| ring.extent_y),
            "mm",
        )
        .within(29.5, 30.5, Derived),
        measured(
            "roundness of the cut circle, least squares",
            "not stated; X and Y differ by 0.5 mm",
            of(&|ring| ring.middle.roundness),
            "mm",
        )
        .at_most(0.5, Derived),
        measured(
            "width of the groove against the sweep of the tool",
            "",
            of(&|ring| {
                (2.0 * (ring.outer.radius - ring.inner.radius) / 2.0 - 2.0 * half_width(2.0)).abs()
            }),
            "mm",
        )
        .at_most(0.1, Own),
        measured("X reverses at", "12 s", extreme(0, -1.0), "s").within(11.5, 12.5, Derived),
        measured("Y reverses first at", "6 s", extreme(1, -1.0), "s").within(5.5, 6.5, Derived),
        measured("Y reverses again at", "18 s", extreme(1, 1.0), "s").within(17.5, 18.5, Derived),
        measured(
            "the turn ends at",
            "24 s (23.56 by the rate)",
            way.last().map_or(f64::NAN, |sample| sample.time),
            "s",
        )
        .within(23.5, 24.5, Derived),
        measured(
            "Fx high, largest magnitude",
            "5 to 10 N",
            largest(moving, |s| s.high[0].abs()),
            "N",
        )
        .within(5.0, 10.0, Stated),
        measured(
            "Fx high opposes the motion (part of the time above 2 mm/s)",
            "opposes",
            opposing(0),
            "",
        )
        .at_least(0.95, Derived),
        measured(
            "Fx high flips at",
            "12 s",
            flip.first().map_or(f64::NAN, |sample| sample.time),
            "s",
        )
        .within(11.0, 13.0, Derived)
        .because(
            "in the model the force of a full slot does not oppose the motion alone, it leans to the side (Fy of a slot is 0.87 of Fx): along X it turns over some 30 degrees of \
             the circle before the motion does",
        ),
        measured(
            "Fy high, largest magnitude",
            "at most 5 N",
            largest(moving, |s| s.high[1].abs()),
            "N",
        )
        .at_most(5.0, Stated)
        .because(
            "the model cuts alike in every direction: its largest force along Y is that along X; the thesis has 5 to 10 N in X and at most 5 N in Y",
        ),
        measured(
            "Fy high opposes the motion (part of the time above 2 mm/s)",
            "opposes",
            opposing(1),
            "",
        )
        .at_least(0.95, Derived),
        measured("Fz high, smallest", "0 to 5 N", smallest(moving, |s| s.high[2]), "N")
            .within(0.0, 5.0, Stated),
        measured("Fz high, largest", "0 to 5 N", largest(moving, |s| s.high[2]), "N")
            .within(0.0, 5.0, Stated),
    ]
}
