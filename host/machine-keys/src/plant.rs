//! Keys of the simulated machine, `[plant]`. The simulator checks the values itself; a test of
//! `haptimill-machine-file` compares its ranges and defaults with these rows.

use crate::key::sections;

sections! {

plant "plant" "The simulated machine, the ground truth. The controller does not read it." {
    seed = other("whole, 0 or more")
        .is("seed of start offsets, noise and link errors; `--seed` replaces it");
    substep_us = whole(5, 50, "us").is("integration step").or(20.0)
        .bounded("a divisor of the control period");
    analog_inputs = other("4 whole numbers, -32768 to 32767")
        .is("constant codes of the analog inputs").or_text("0");
}

plant_input "plant.input" "A digital input of the simulated machine; faults use its name." {
    name = text("text").is("name").bounded("unique");
    channel = other("0 to 31, whole").is("channel of the board").bounded("each once");
    high = other("`true`, `false`").is("the level is high at rest").or_text("false");
}

plant_probe "plant.probe" "A block in the workpiece frame that a probe in the spindle touches." {
    input = text("the name of a `[[plant.input]]`").is("input whose level a contact inverts");
    low = list(3, -2000.0, 2000.0, "mm").is("lower corner of the block");
    high = list(3, -2000.0, 2000.0, "mm").is("upper corner of the block");
    radius = other("0 to 50 mm").is("radius of the ball; 0 is a point");
    pretravel = other("0 to 10 mm").is("travel into the block at which the contact begins")
        .or_text("0");
}

plant_tool_setter "plant.tool_setter" "A block that the tool touches; the keys are those of `[plant.probe]`." {
    input = text("the name of a `[[plant.input]]`").is("input whose level a contact inverts");
    low = list(3, -2000.0, 2000.0, "mm").is("lower corner of the block");
    high = list(3, -2000.0, 2000.0, "mm").is("upper corner of the block");
    radius = other("0 to 50 mm").is("radius of the ball; 0 is a point");
    pretravel = other("0 to 10 mm").is("travel into the block at which the contact begins")
        .or_text("0");
}

joint "plant.joint" "A simulated joint, with the name of the controller's: motor, screw and slide." {
    name = text("the controller's name").is("name of the joint");
    kind = word(&["linear", "rotary"]).is("mm, N, kg; or degrees, N m, kg m^2");
    lead = real(0.01, 1000.0, "mm/turn").is("motion per motor turn")
        .rotary("lead", real(0.01, 1000.0, "deg/turn"));
    inertia = real(1e-6, 1e5, "kg").is("all that moves").rotary("inertia", real(1e-6, 1e5, "kg m^2"));
    motor_share = real(0.05, 0.95, "").is("fraction of the inertia on the side of the motor");
    mode_hz = real(1.0, 2000.0, "Hz").is("frequency of motor against slide")
        .bounded("below 0.3 / (2 pi substep)");
    mode_damping = real(0.0, 1.0, "").is("damping ratio of that mode");
    backlash = real(0.0, 1000.0, "mm").is("width of the gap between screw and slide")
        .rotary("backlash", real(0.0, 1000.0, "deg")).bounded("at most the lead");
    coulomb = real(0.0, 1e6, "N").is("Coulomb friction of both sides together")
        .rotary("coulomb", real(0.0, 1e6, "N m"));
    viscous = real(0.0, 1e6, "N per mm/s").is("viscous friction of both sides together")
        .rotary("viscous", real(0.0, 1e6, "N m per deg/s"));
    friction_slide_share = real(0.0, 1.0, "").is("fraction of the friction on the side of the slide");
    low = real(-2000.0, 2000.0, "mm").is("lower hard stop").rotary("low", real(-200_000.0, 200_000.0, "deg"));
    high = real(-2000.0, 2000.0, "mm").is("upper hard stop").bounded("above the lower one")
        .rotary("high", real(-200_000.0, 200_000.0, "deg"));
    stop_stiffness = other("0 to a bound by substep and inertia; N/mm, N m/deg")
        .is("stiffness of the hard stops");
    preset = real(-2000.0, 2000.0, "mm").is("position of the slide at the start")
        .bounded("between the hard stops").rotary("preset", real(-200_000.0, 200_000.0, "deg"));
    start_spread = real(0.0, 2000.0, "mm").is("largest random offset of it, by the seed").or(0.0)
        .bounded("at most the distance to the nearer stop")
        .rotary("start_spread", real(0.0, 2000.0, "deg"));
    home = other("the keys of `[plant.joint.home]`").is("home switch").or_absent();
    active_low = other("list of \"home\", \"limit-low\", \"limit-high\"")
        .is("switches whose line is low while they are active, such as contacts that open")
        .or_text("[]");
    limit_low = real(-4000.0, 4000.0, "mm").is("lower limit switch").or_absent()
        .rotary("limit_low", real(-400_000.0, 400_000.0, "deg")).bounded("below the upper one");
    limit_high = real(-4000.0, 4000.0, "mm").is("upper limit switch").or_absent()
        .rotary("limit_high", real(-400_000.0, 400_000.0, "deg"));
    gantry_of = text("the name of another joint")
        .is("the joint is the second motor of a gantry, at the other end of the beam of that joint; it is no joint of the geometry, which sees the middle of the beam")
        .or_absent().bounded("a linear joint with one motor; both have the same preset");
    racking_stiffness = real(0.0, 1e6, "N/mm")
        .is("stiffness of the beam against racking; 0: its ends are not coupled").or(0.0)
        .only("second motors of gantries").bounded("a bound by substep and inertia");
    racked = real(-100.0, 100.0, "mm").is("racking at power-on: this joint minus the other one").or(0.0)
        .only("second motors of gantries").bounded("0 on other joints");
}

joint_home "plant.joint.home" "The home switch." {
    at = real(-4000.0, 4000.0, "mm").is("coordinate at which it changes")
        .rotary("at", real(-400_000.0, 400_000.0, "deg"));
    active = word(&["below", "above"]).is("side on which it is active");
    hysteresis = real(0.0, 100.0, "mm").is("distance back to the release").or(0.0)
        .rotary("hysteresis", real(0.0, 100.0, "deg"));
    bounce_ms = real(0.0, 1000.0, "ms").is("time for which the contact bounces after a change")
        .or(0.0);
}

joint_encoder "plant.joint.encoder" "The encoder, on the motor shaft or on the slide." {
    on = word(&["motor", "slide"])
        .is("motor shaft, or slide: a linear scale with a reference mark each lead")
        .or_text("\"motor\"");
    counts_per_turn = whole(4, 4_000_000, "counts")
        .is("counts per motor turn, or per lead of the slide, after x4 decoding")
        .bounded("a multiple of 4");
    index = real(-4000.0, 4000.0, "mm").is("position of an index pulse; the others are whole leads away")
        .rotary("index", real(-400_000.0, 400_000.0, "deg"));
    reversed = flag().is("counts backwards").or_text("false");
}

joint_torque "plant.joint.drive.torque" "A current-mode amplifier." {
    full_scale = real(-1e6, 1e6, "N").is("effort of code 8192").bounded("magnitude 1e-6 or more")
        .rotary("full_scale", real(-1e6, 1e6, "N m"));
    limit = real(0.0, 1e6, "N").is("largest effort").rotary("limit", real(0.0, 1e6, "N m"));
}

joint_steps "plant.joint.drive.steps" "A step motor with its drive." {
    full_steps = whole(4, 10_000, "steps").is("full steps per turn");
    phases = whole(2, 5, "").is("phases; an electrical turn is two full steps for each").or(2.0);
    microsteps = whole(1, 1024, "").is("steps per full step");
    pull_out = real(0.0, 1e6, "N").is("largest static effort").rotary("pull_out", real(0.0, 1e6, "N m"))
        .bounded("above `coulomb` of the joint");
    damping = real(0.0, 1e6, "N per mm/s").is("damping by the drive").or(0.0)
        .rotary("damping", real(0.0, 1e6, "N m per deg/s"));
    reversed = flag().is("a positive step moves downwards").or_text("false")
        .bounded("as `direction` of the joint of the controller");
    ticks_per_us = whole(1, 1000, "ticks/us").is("step clock of the board")
        .bounded("that of the joint of the controller");
    pulse_ns = real(0.0, 1e6, "ns").is("width of the pulses of the board");
    min_high_ns = real(0.0, 1e6, "ns").is("shortest pulse that the drive detects")
        .bounded("at most `pulse_us` of the joint of the controller");
    min_low_ns = real(0.0, 1e6, "ns").is("shortest pause between two pulses")
        .bounded("at most `pulse_us` of the joint of the controller");
    setup_ns = real(0.0, 1e6, "ns").is("shortest time from a change of direction to a pulse")
        .bounded("at most `setup_us` of the joint of the controller");
    hold_ns = real(0.0, 1e6, "ns").is("shortest time from a pulse to a change of direction")
        .bounded("at most `hold_us` of the joint of the controller");
}

spindle "plant.spindle" "The spindle; optional." {
    time_constant_s = real(0.0, 60.0, "s").is("time constant of the speed").or(0.3);
}

cutter "plant.cutter" "The cutter, a ball-end mill; optional." {
    radius_mm = real(0.05, 25.0, "mm").is("radius of ball and shank").or(4.0);
    helix_deg = real(0.0, 60.0, "deg").is("helix angle").or(30.0);
    teeth = whole(1, 8, "").is("number of teeth").or(2.0);
    flute_length_mm = real(0.5, 200.0, "mm").is("height of the flutes").or(16.0)
        .bounded("at least the radius");
    slices = whole(4, 128, "").is("slices of the ball in which the force is summed").or(32.0);
    material = other("\"P1\", \"P2\", or { tangential, radial, axial, tangential_edge, radial_edge, axial_edge }")
        .is("cutting coefficients, N/mm^2 and N/mm").or_text("\"P1\"");
    force_scale = real(0.0, 1000.0, "").is("factor on all forces of the cut").or(1.0);
    edge_onset_mm = real(0.0, 0.1, "mm")
        .is("chip thickness from which on the edge force has its full value").or(0.0002);
    relief_mm = real(0.01, 5.0, "mm").is("how far the body lies behind the edges").or(0.15);
    body_stiffness = real(0.0, 1e6, "N/mm^3").is("pressure of the body per depth").or(100.0);
    body_pressure = real(0.0, 1e5, "N/mm^2").is("pressure at which the material yields").or(60.0);
}

structure "plant.structure" "Elastic structure between slides and tool; without it the machine is rigid." {
    stiffness = list(3, 1.0, f64::INFINITY, "N/mm").is("stiffness in x, y, z; inf is rigid")
        .or_text("[500.0, 500.0, 1000.0]");
    time_constant_s = real(0.0, 1.0, "s").is("its time constant").or(0.001);
}

sensor "plant.sensor" "The force sensor under the workpiece; optional." {
    full_scale_n = real(0.1, 1e6, "N").is("force at the end of the range of the converter").or(100.0);
    range_n = real(0.1, f64::INFINITY, "N").is("largest force of the amplifier").or(100.0);
    high_pass_s = real(0.001, f64::INFINITY, "s")
        .is("time constant of the high-pass of the amplifier").or(1000.0);
    drift_n_s = list(3, -1000.0, 1000.0, "N/s").is("drift in x, y, z")
        .or_text("[0.01, -0.006, 0.015]");
    noise_n = real(0.0, 1000.0, "N").is("standard deviation of a sample").or(0.025);
    vise_kg = real(0.0, 1000.0, "kg").is("mass of vise and workpiece on the sensor").or(3.0);
}

workpiece "plant.workpiece" "A stock on the table from power-on; a stock file has the same keys." {
    stock = other("{ x_min, x_max, y_min, y_max }, -2000 to 2000 mm, at least 1 mm wide")
        .is("extent of the material")
        .or_text("{ x_min = -90.0, x_max = 50.0, y_min = -60.0, y_max = 60.0 }");
    map = other("as `stock`; at most 5e7 cells")
        .is("where the cut surface is kept; outside it the stock stays uncut")
        .or_text("{ x_min = -60.0, x_max = 8.0, y_min = -22.0, y_max = 22.0 }");
    cell_mm = real(0.01, 1.0, "mm").is("distance of the points of the map").or(0.05);
    top_mm = real(-2000.0, 2000.0, "mm").is("height of the top at x = y = 0").or(0.0);
    bottom_mm = real(-4000.0, 2000.0, "mm").is("underside").or(-30.0).bounded("below top_mm");
    rise_x_deg = real(-60.0, 60.0, "deg").is("angle by which the top rises towards +x").or(0.0);
    rise_y_deg = real(-60.0, 60.0, "deg").is("angle by which the top rises towards +y").or(0.0);
}

haptic "plant.haptic" "The simulated haptic arm; optional." {
    link_kg = real(0.0, 10.0, "kg").is("mass of a link").or(0.06);
    amplifier_lag_s = real(0.0, 1.0, "s").is("time constant of the current").or(0.0005);
    balance = real(0.0, 1.0, "").is("fraction of the weight that is balanced").or(1.0);
    start_mm = list(3, -500.0, 500.0, "mm").is("true position of the handle at power-on, from home")
        .or_text("[0.0, 0.0, 0.0]");
}

haptic_geometry "plant.haptic.geometry" "Its lengths." {
    base_radius_mm = real(1.0, 2000.0, "mm").is("r_b, as in `[haptic.geometry]`").or(150.0);
    link_mm = real(1.0, 2000.0, "mm").is("L").or(200.0);
    platform_radius_mm = real(1.0, 2000.0, "mm").is("r_p").or(50.0);
    azimuth_deg = list(3, -360.0, 360.0, "deg").is("theta1").or_text("[0.0, 120.0, 240.0]");
    tilt_deg = real(-80.0, 80.0, "deg").is("theta2").or(30.0);
    home_mm = list(3, -2000.0, 2000.0, "mm").is("platform at home").or_text("[0.0, 0.0, 450.0]");
    tip_mm = list(3, -2000.0, 2000.0, "mm").is("tip from the platform").or_text("[0.0, 0.0, 150.0]");
}

haptic_handle "plant.haptic.handle" "Platform and handle; a section has all keys." {
    mass_kg = real(0.01, 100.0, "kg").is("mass");
    centre_mm = list(3, -1000.0, 1000.0, "mm").is("centre of mass");
    inertia_kg_mm2 = list(3, 1.0, 1e7, "kg mm^2").is("inertia about x, y, z");
}

haptic_slide "plant.haptic.slide" "The motors of the slides d; a section has all keys." {
    inertia = real(0.0, 1e5, "kg").is("inertia");
    coulomb = real(0.0, 1e5, "N").is("Coulomb friction");
    viscous = real(0.0, 1e4, "N s/mm").is("viscous friction");
    full_scale = real(-1e6, 1e6, "N").is("force of full scale").bounded("magnitude 1e-6 or more");
    limit = real(0.0, 1e6, "N").is("largest force");
}

haptic_turn "plant.haptic.turn" "The motors of theta3; a section has all keys." {
    inertia = real(0.0, 1e5, "kg mm^2").is("inertia");
    coulomb = real(0.0, 1e5, "N mm").is("Coulomb friction");
    viscous = real(0.0, 1e4, "N mm s/rad").is("viscous friction");
    full_scale = real(-1e6, 1e6, "N mm").is("moment of full scale").bounded("magnitude 1e-6 or more");
    limit = real(0.0, 1e6, "N mm").is("largest moment");
}

haptic_encoders "plant.haptic.encoders" "Its encoders." {
    slide_counts_per_mm = real(0.1, 1e8, "counts/mm").is("counts of the slides").or(200.0);
    turn_counts_per_turn = real(100.0, 1e8, "counts/turn").is("counts of theta3").or(160_000.0);
    hinge_counts_per_turn = real(100.0, 1e8, "counts/turn").is("counts of theta4").or(160_000.0);
    reversed = other("3 x 3 of true, false").is("counts backwards: slide, turn, hinge of each leg")
        .or_text("false");
}

haptic_stops "plant.haptic.stops" "Its end stops; a section has all keys." {
    slide_mm = list(2, -2000.0, 4000.0, "mm").is("ends of the slides");
    hinge_deg = list(2, 1.0, 89.0, "deg").is("ends of theta4");
    slide_stiffness = real(0.0, 200.0, "N/mm").is("stiffness of the slides' stops");
    hinge_stiffness = real(0.0, 1e6, "N mm/rad").is("stiffness of the hinges' stops");
}

operator "plant.operator" "The operator model at the haptic arm; optional, needs `[plant.haptic]`." {
    grip_mm = list(3, -500.0, 500.0, "mm").is("where the handle is held").or_text("[0.0, 0.0, 75.0]");
    mass_kg = real(0.0, 10.0, "kg").is("moving mass of the hand").or(0.5);
    stiffness = real(0.001, 20.0, "N/mm").is("stiffness of the hand").or(0.8);
    damping = real(0.0, 2.0, "N s/mm").is("damping of the hand").or(0.04);
    turn_stiffness = real(1.0, 1e6, "N mm/rad").is("stiffness against turning").or(5000.0);
    turn_damping = real(0.0, 1e5, "N mm s/rad").is("damping against turning").or(150.0);
    force_limit_n = real(0.0, 200.0, "N").is("largest force").or(12.0);
    moment_limit_n_mm = real(0.0, 1e5, "N mm").is("largest moment").or(2000.0);
    reaction_s = real(0.0, 2.0, "s").is("reaction time").or(0.2);
    smoothing_s = real(0.0, 10.0, "s").is("time constant of the perceived force").or(0.3);
    effort_gain = real(0.0, 100.0, "").is("gain of the correction of a visible error").or(3.0);
    effort_s = real(0.01, 100.0, "s").is("its time constant").or(1.2);
    stop_force_n = real(0.01, f64::INFINITY, "N").is("resistance that stops the hand").or(7.0);
}

}
