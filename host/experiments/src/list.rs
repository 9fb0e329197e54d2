//! The scenarios.

use super::{Control, Led, Pass, Scenario, Work, felt, incline, led, programmed};

/// A pass over the flat block, as fitted, without force control.
const fn flat(program: &'static str, text: &'static str) -> Pass {
    Pass {
        name: "cut",
        title: "",
        program,
        text,
        work: Work::Block,
        force_scale: 1.0,
        control: None,
        led: None,
    }
}

/// The scale of the forces on the incline, of coefficients P1 (docs/control.md 5.2).
const INCLINE_SCALE: f64 = 2.0;

const fn tilted(
    name: &'static str,
    title: &'static str,
    program: &'static str,
    text: &'static str,
    control: Option<Control>,
) -> Pass {
    Pass {
        name,
        title,
        program,
        text,
        work: Work::Incline,
        force_scale: INCLINE_SCALE,
        control,
        led: None,
    }
}

/// A pass up the incline under force control, f_d 5 N.
const fn yielding(
    name: &'static str,
    title: &'static str,
    feed: u8,
    mass: f64,
    damping: f64,
) -> Pass {
    let control = Some(Control {
        desired_n: 5.0,
        mass,
        damping,
    });
    match feed {
        2 => tilted(
            name,
            title,
            "e5-incline-2.ngc",
            include_str!("../../../examples/e5-incline-2.ngc"),
            control,
        ),
        _ => tilted(
            name,
            title,
            "e5-incline-4.ngc",
            include_str!("../../../examples/e5-incline-4.ngc"),
            control,
        ),
    }
}

/// A pass that a hand leads, f_d 5 N, K_A 1, K_V 5 (the gains recommended by E5; those of the experiments with a hand are not restated).
const fn by_hand(
    name: &'static str,
    title: &'static str,
    program: &'static str,
    text: &'static str,
    led: Led,
) -> Pass {
    let control = if led.axes.is_empty() {
        None
    } else {
        Some(Control {
            desired_n: 5.0,
            mass: 1.0,
            damping: 5.0,
        })
    };
    Pass {
        name,
        title,
        program,
        text,
        work: Work::Block,
        force_scale: 1.0,
        control,
        led: Some(led),
    }
}

/// X on the rail, with the reflection of slot and pocket (docs/control.md 3.4; the limit of Y in them is not stated).
const ON_THE_RAIL: Led = Led {
    axes: &[0],
    yields: &[0],
    rail: Some([-1.0, 0.0, 0.0]),
    part: false,
    reflect: [(40, 3.2), (10, 3.2), (20, 1.2)],
    boost: 0.0,
    wall_mm_s: None,
    trajectory: led::once,
};

/// The wall of E6, on a rail; nothing is cut.
const AT_THE_WALL: Led = Led {
    axes: &[],
    reflect: [(0, 0.0), (0, 0.0), (0, 0.0)],
    wall_mm_s: Some(-4.0),
    trajectory: led::swiftly,
    ..ON_THE_RAIL
};

/// All scenarios, in the order of the thesis.
#[must_use]
pub fn all() -> Vec<Scenario> {
    vec![
        Scenario {
            name: "e1",
            title: "Feed sweep, no force control",
            setting: "A slot 2 mm deep towards -X: 3 s each at 2, 6 and 10 mm/s.",
            figures: "figures 4.4 to 4.7, p. 41-44",
            passes: vec![flat(
                "e1-feed-sweep.ngc",
                include_str!("../../../examples/e1-feed-sweep.ngc"),
            )],
            claims: programmed::feed_sweep,
        },
        Scenario {
            name: "e2",
            title: "Depth sweep, no force control",
            setting: "A slot towards -X at 2 mm/s: 10 mm each at depths of 1, 3 and 5 mm. The thesis counts 5 s for each; here the tool stands in x while it plunges to \
                      the next depth at 1 mm/s.",
            figures: "figures 4.8 to 4.11, p. 44-46",
            passes: vec![flat(
                "e2-depth-sweep.ngc",
                include_str!("../../../examples/e2-depth-sweep.ngc"),
            )],
            claims: programmed::depth_sweep,
        },
        Scenario {
            name: "e3",
            title: "Incline, no force control",
            setting: "A part that rises by 10 degrees towards -X: 20 mm at 2 and at 4 mm/s, from 1 mm deep.",
            figures: "figure 4.12, p. 47",
            passes: vec![
                tilted(
                    "2mm-s",
                    "2 mm/s",
                    "e3-incline-2.ngc",
                    include_str!("../../../examples/e3-incline-2.ngc"),
                    None,
                ),
                tilted(
                    "4mm-s",
                    "4 mm/s",
                    "e3-incline-4.ngc",
                    include_str!("../../../examples/e3-incline-4.ngc"),
                    None,
                ),
            ],
            claims: incline::position_only,
        },
        Scenario {
            name: "e4",
            title: "Incline, three sets of gains",
            setting: "The incline at 2 mm/s with force control along X, f_d 5 N (derived; the thesis states it for E5): the tool yields by p_c.",
            figures: "figure 4.13, p. 48",
            passes: vec![
                yielding("ka0.25-kv5", "K_A 0.25, K_V 5", 2, 0.25, 5.0),
                yielding("ka1-kv5", "K_A 1, K_V 5", 2, 1.0, 5.0),
                yielding("ka1-kv20", "K_A 1, K_V 20", 2, 1.0, 20.0),
            ],
            claims: incline::gain_study,
        },
        Scenario {
            name: "e5",
            title: "Incline with force control",
            setting: "The incline at 2 mm/s with force control along X, f_d 5 N: 20 mm by 10 s, watched to 15 s and, beyond the thesis, 20 s from the stop. The gains \
                      0.25 and 0.5 are not the thesis's: the softest that hold the force.",
            figures: "figures 4.14 and 4.15, p. 49-50",
            passes: vec![
                yielding("ka1-kv5", "K_A 1, K_V 5", 2, 1.0, 5.0),
                yielding("ka1-kv20", "K_A 1, K_V 20", 2, 1.0, 20.0),
                yielding("ka0.25-kv0.5", "K_A 0.25, K_V 0.5", 2, 0.25, 0.5),
                yielding(
                    "ka0.25-kv0.5-4mm-s",
                    "K_A 0.25, K_V 0.5, 4 mm/s",
                    4,
                    0.25,
                    0.5,
                ),
            ],
            claims: incline::force_control,
        },
        Scenario {
            name: "e6",
            title: "Moving wall",
            setting: "The handle on its rail, away towards -X; a virtual wall of 0.35 N/mm (derived, docs/control.md 3.5) follows at 4 mm/s. In the second pass, not of the thesis, the hand stays behind the \
                      wall.",
            figures: "figures 4.16 and 4.17, p. 50-52",
            passes: vec![
                by_hand(
                    "swift",
                    "faster than the wall",
                    "e6-hand.ngc",
                    include_str!("../../../examples/e6-hand.ngc"),
                    AT_THE_WALL,
                ),
                by_hand(
                    "slow",
                    "behind the wall",
                    "e6-hand.ngc",
                    include_str!("../../../examples/e6-hand.ngc"),
                    Led {
                        trajectory: led::slowly,
                        ..AT_THE_WALL
                    },
                ),
            ],
            claims: felt::moving_wall,
        },
        Scenario {
            name: "e7",
            title: "Slot, no force control",
            setting: "30 mm towards -X at 4 mm/s, 2 mm deep.",
            figures: "figures 4.18 to 4.22, p. 53-56",
            passes: vec![flat(
                "e7-slot.ngc",
                include_str!("../../../examples/e7-slot.ngc"),
            )],
            claims: programmed::slot,
        },
        Scenario {
            name: "e8",
            title: "Slot by hand, with force control",
            setting: "A hand on the rail leads X by 30 mm towards -X; 2 mm deep, force control along X with f_d 5 N; 40 % of Fx up to 3.2 N, 10 % of Fy and 20 % of Fz up to 1.2 N come back to \
                      the hand.",
            figures: "figures 4.23 to 4.28, p. 56-60",
            passes: vec![by_hand(
                "cut",
                "",
                "e8-hand.ngc",
                include_str!("../../../examples/e8-hand.ngc"),
                ON_THE_RAIL,
            )],
            claims: felt::slot,
        },
        Scenario {
            name: "e9",
            title: "Pocket, no force control",
            setting: "-30 X, -2 Y, +30 X, -2 Y, -30 X; 4 mm/s along X, 1 mm/s along Y, 2 mm deep.",
            figures: "figures 4.29 to 4.33, p. 61-64",
            passes: vec![flat(
                "e9-pocket.ngc",
                include_str!("../../../examples/e9-pocket.ngc"),
            )],
            claims: programmed::pocket,
        },
        Scenario {
            name: "e10",
            title: "Pocket by hand, with force control",
            setting: "A hand on the rail leads X to and fro by 30 mm, the program Y by -2 mm between; 2 mm deep, force control along X and Z with f_d 5 N. Where the reflection is too weak to be felt, 0.1 N \
                      for each mm/s of the hand is added; the second pass goes without.",
            figures: "figures 4.34 to 4.39, p. 65-70",
            passes: vec![
                by_hand(
                    "boost",
                    "with boost",
                    "e10-hand.ngc",
                    include_str!("../../../examples/e10-hand.ngc"),
                    Led {
                        yields: &[0, 2],
                        boost: 0.1,
                        trajectory: led::three_times,
                        ..ON_THE_RAIL
                    },
                ),
                by_hand(
                    "plain",
                    "without boost",
                    "e10-hand.ngc",
                    include_str!("../../../examples/e10-hand.ngc"),
                    Led {
                        yields: &[0, 2],
                        trajectory: led::three_times,
                        ..ON_THE_RAIL
                    },
                ),
            ],
            claims: felt::pocket,
        },
        Scenario {
            name: "e11",
            title: "Circle, no force control",
            setting: "A circle of 30 mm at 4 mm/s, 2 mm deep, from X0 Y0 first towards -X and -Y.",
            figures: "figures 4.40 to 4.44, p. 71-74",
            passes: vec![flat(
                "e11-circle.ngc",
                include_str!("../../../examples/e11-circle.ngc"),
            )],
            claims: programmed::circle,
        },
        Scenario {
            name: "e12",
            title: "Circle by hand, with force control",
            setting: "A free hand leads X and Y: the ball of 5 mm at the handle's tip goes round in a hole of 35 mm, pressed against its edge with 2 N. 2 mm deep, force control along X and Y with f_d 5 N; \
                      40 % of Fx and Fy up to 3.2 N, 20 % of Fz up to 1.2 N come back.",
            figures: "figures 4.45 to 4.50, p. 74-79",
            passes: vec![by_hand(
                "cut",
                "",
                "e12-hand.ngc",
                include_str!("../../../examples/e12-hand.ngc"),
                Led {
                    axes: &[0, 1],
                    yields: &[0, 1],
                    rail: None,
                    part: true,
                    reflect: [(40, 3.2), (40, 3.2), (20, 1.2)],
                    trajectory: led::round,
                    ..ON_THE_RAIL
                },
            )],
            claims: felt::circle,
        },
    ]
}

/// The scenario of this name.
#[must_use]
pub fn named(name: &str) -> Option<Scenario> {
    all()
        .into_iter()
        .find(|scenario| scenario.name.eq_ignore_ascii_case(name))
}
