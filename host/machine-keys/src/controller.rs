//! Keys of the machine as controller and planner know it: root, model, axes, planner, force.

use crate::key::{Values, real, sections};

/// Coordinates of a linear axis. The controller's numbers end at +-2048 mm; it keeps 148 mm for
/// sums and differences of positions.
const LENGTHS: Values = real(-1900.0, 1900.0, "mm");

/// Coordinates of a rotary axis within one turn; the controller keeps the same part of its range.
const ANGLES: Values = real(-166.99, 166.99, "deg");

/// Coordinates of a multi-turn rotary joint; the controller counts +-512 turns.
const MULTI_TURN: Values = real(-170_000.0, 170_000.0, "deg");

/// What to do about a longer stroke of each kind of joint.
const LONGER: [&str; 3] = [
    "put the zero of the joint into the middle of its stroke: 3800 mm fit, from -1900 to 1900",
    "write `wrap = true` and no limits where the coordinate turns on and the model allows it, or use a \
     model with a multi-turn joint (docs/machine-files.md)",
    "put the zero of the joint into the middle of its stroke: 944 turns fit",
];

/// Rates of a multi-turn rotary joint, up to 500 turns per second.
const MULTI_TURN_RATES: Values = real(0.001, 180_000.0, "deg/s");

/// Joints to which the keys of an encoder apply.
const ENCODER: &str = "joints with an encoder";

sections! {

root "" "The machine and its control period." {
    format = whole(1, 1000, "").is("format of the file, its first key; without it the format is 1");
    name = text("1 to 24 bytes").is("name in reports and in the session");
    period_us = whole(50, 1000, "us").is("control period").bounded("a divisor of 1,000,000");
    role = word(&["machine", "master"])
        .is("`master`: a haptic arm without joints; then only `name`, `period_us`, `role`, `[supervision]`, `[haptic]` and `[plant]` are read")
        .or_text("\"machine\"");
}

kinematics "kinematics" "The model; its lengths are keys of the model." {
    model = named("the name of a model")
        .is("model of the machine: number, names, kinds and order of coordinates and joints");
}

pose "pose" "A pose coordinate: its soft limits, and the maximum rate, acceleration and jerk of programs and jogs." {
    name = text("the name that the model has at this place").is("name of the coordinate");
    kind = word(&["linear", "rotary"]).is("kind that the model has at this place");
    low = super::LENGTHS.is("lower soft limit").named("low_mm")
        .rotary("low_deg", super::ANGLES).multi_turn(super::MULTI_TURN)
        .bounded("below the upper one; a coordinate that is a joint within its stroke")
        .beyond(super::LONGER);
    high = super::LENGTHS.is("upper soft limit").named("high_mm")
        .rotary("high_deg", super::ANGLES).multi_turn(super::MULTI_TURN)
        .beyond(super::LONGER);
    wrap = flag().is("the coordinate turns without limits and has no soft limits")
        .only("rotary coordinates without a role, and those of a table").or_text("false")
        .bounded("the joint of the same name wraps too");
    rate = real(0.001, 2000.0, "mm/s").is("maximum rate").named("rate_mm_s")
        .rotary("rate_deg_s", real(0.001, 179.0, "deg/s")).multi_turn(super::MULTI_TURN_RATES)
        .bounded("at most the joint's where the coordinate is a joint");
    acceleration = real(0.1, 100_000.0, "mm/s^2").is("maximum acceleration")
        .named("acceleration_mm_s2").rotary("acceleration_deg_s2", real(0.1, 40_000.0, "deg/s^2"));
    jerk = real(1.0, 1e8, "mm/s^3")
        .is("maximum jerk; the controller refuses one that is too low for the acceleration")
        .named("jerk_mm_s3").rotary("jerk_deg_s3", real(1.0, 1e8, "deg/s^3"));
}

joint "joint" "A joint: stroke, rate, encoder and reference." {
    name = text("the name that the model has at this place; free for the second motor of a gantry")
        .is("name of the joint");
    kind = word(&["linear", "rotary"]).is("kind that the model has at this place");
    gantry_of = text("the name of a joint of the model")
        .is("the joint is the second motor of a gantry: it gets the motion of that joint, and homing squares the two by their switches")
        .or_absent()
        .bounded("after the joints of the model; linear; `home`, `preset` and `[joint.switch]` have the same values as the other motor, except `input`, `at`, `release` and `travel`; the stroke contains, and the rate reaches that of the other motor");
    racking = real(0.001, 100.0, "mm")
        .is("largest racking: distance between the two motors of a gantry, and in homing the difference of their motions")
        .named("racking_mm").only("second motors of gantries");
    low = super::LENGTHS.is("lower end of the stroke").named("low_mm")
        .rotary("low_deg", super::ANGLES).multi_turn(super::MULTI_TURN)
        .bounded("below the upper end").beyond(super::LONGER);
    high = super::LENGTHS.is("upper end of the stroke").named("high_mm")
        .rotary("high_deg", super::ANGLES).multi_turn(super::MULTI_TURN)
        .beyond(super::LONGER);
    wrap = flag().is("the joint turns without limits and has no stroke")
        .only("rotary joints").or_text("false")
        .bounded("the pose coordinate of the same name wraps too; of a joint that is no coordinate: where the model allows it");
    rate = real(0.001, 2000.0, "mm/s").is("maximum rate").named("rate_mm_s")
        .rotary("rate_deg_s", real(0.001, 179.0, "deg/s")).multi_turn(super::MULTI_TURN_RATES);
    acceleration = real(0.1, 100_000.0, "mm/s^2").is("maximum acceleration")
        .named("acceleration_mm_s2").rotary("acceleration_deg_s2", real(0.1, 40_000.0, "deg/s^2"));
    travel = real(0.01, 200.0, "mm/turn").is("motion per motor turn").named("lead_mm")
        .rotary("gear_ratio", real(0.1, 1_000.0, "motor turns per turn"));
    home = word(&["index", "switch", "switch_and_index", "none"])
        .is("how the joint finds its reference: by the index pulse nearest to the preset, by a switch, by the index pulse next to a switch, or not at all: it is at its preset")
        .or_text("\"index\" with an encoder, required without one");
    home_active = word(&["high", "low"]).is("level of the home switch's line when it is active")
        .or_text("\"high\"");
    limit_low_active = word(&["high", "low"])
        .is("level of the lower limit switch's line when it is active").or_text("\"high\"");
    limit_high_active = word(&["high", "low"])
        .is("level of the upper limit switch's line when it is active").or_text("\"high\"");
    counts_per_turn = whole(4, 10_000_000, "counts")
        .is("encoder counts per motor turn, after x4 decoding; without it the joint has no encoder and is open loop")
        .or_absent().bounded("required with a torque drive");
    direction = plus_minus().is("-1: the encoder counts backwards").only(super::ENCODER);
    backlash = real(0.0, 100.0, "mm").is("lost motion that is compensated").named("backlash_mm")
        .rotary("backlash_deg", real(0.0, 30.0, "deg")).or(0.0).bounded("below one motor turn");
    backlash_table = other("2 to 16 numbers, 0 to 100 mm")
        .is("lost motion at evenly spaced positions from the lower to the upper end of the stroke, in place of `backlash_mm`")
        .named("backlash_table_mm")
        .rotary("backlash_table_deg", other("2 to 16 numbers, 0 to 30 deg")).or_absent()
        .bounded("changes by at most 1/256 of the distance; below one motor turn").only("joints with a stroke");
    following_error = real(0.0, 100.0, "mm").is("largest following error at standstill")
        .named("following_error_mm").rotary("following_error_deg", real(0.0, 30.0, "deg"))
        .bounded("above 0, at most one motor turn").only(super::ENCODER);
    following_error_lag_ms = real(0.0, 1000.0, "ms")
        .is("this time multiplied by the commanded rate is added to the limit of the following error").only(super::ENCODER);
    encoder_stuck = real(0.0, 100.0, "mm").is("commanded motion without a count that is an encoder fault")
        .named("encoder_stuck_mm").rotary("encoder_stuck_deg", real(0.0, 30.0, "deg"))
        .bounded("at least 4 counts").only(super::ENCODER);
    preset = super::LENGTHS
        .is("joint position of the home pose; where the joint homes by index or not at all, the operator sets it before power-on").named("preset_mm")
        .rotary("preset_deg", super::ANGLES).multi_turn(super::MULTI_TURN).bounded("within the stroke");
    index = super::LENGTHS
        .is("index pulse nearest to the preset, measured once for each machine").named("index_mm")
        .rotary("index_deg", super::ANGLES).multi_turn(super::MULTI_TURN)
        .bounded("within the stroke, and within the search distance of the preset").only(super::ENCODER);
    search = real(0.0, 100.0, "mm").is("largest distance of an index pulse from its position")
        .named("search_mm").rotary("search_deg", real(0.0, 30.0, "deg"))
        .bounded("above 0, below half a motor turn").only(super::ENCODER);
    index_slack_counts = whole(0, 65_535, "counts")
        .is("counts by which an index pulse may be off; 0 switches the index monitor off")
        .or_text("4, or less for a coarse encoder").bounded("below a quarter of a turn").only(super::ENCODER);
}

joint_switch "joint.switch" "Homing by a switch, where `home` is \"switch\" or \"switch_and_index\"." {
    home_order = whole(1, 6, "").is("the lowest number is searched first; joints with equal numbers move at the same time")
        .or(1.0);
    input = word(&["home", "limit_low", "limit_high"])
        .is("the switch; a limit switch is no fault until the machine is homed")
        .or_text("\"home\"");
    towards = word(&["down", "up"]).is("direction in which the joint moves to its switch")
        .bounded("down to `limit_low`, up to `limit_high`");
    at = super::LENGTHS
        .is("joint position where the switch becomes active, measured once for each machine")
        .named("at_mm").rotary("at_deg", super::ANGLES).multi_turn(super::MULTI_TURN).bounded("within the stroke");
    rate = real(0.001, 2000.0, "mm/s").is("rate to the switch (first touch), off it, and over the back-off").named("rate_mm_s")
        .rotary("rate_deg_s", real(0.001, 179.0, "deg/s")).multi_turn(super::MULTI_TURN_RATES)
        .bounded("at most the joint's; stops within the release distance");
    touch_rate = real(0.001, 100.0, "mm/s").is("rate of the second touch, which finds the reference, and to the index pulse behind it")
        .named("touch_rate_mm_s").rotary("touch_rate_deg_s", real(0.001, 30.0, "deg/s"))
        .bounded("at most the rate to the switch");
    back_off = real(0.01, 100.0, "mm")
        .is("distance off the released switch before the second touch, and off the reference at the end; the two touches differ by at most a quarter of it")
        .named("back_off_mm").rotary("back_off_deg", real(0.01, 30.0, "deg"))
        .bounded("homing ends within the stroke");
    release = real(0.01, 200.0, "mm")
        .is("longest motion off the active switch until it is released, also from the end of the stroke")
        .named("release_mm").rotary("release_deg", real(0.01, 60.0, "deg"))
        .or_text("three times the back-off, at least the stroke behind the switch and the back-off");
    travel = real(0.1, 1900.0, "mm").is("longest motion to the switch; homing fails if the switch does not become active").named("travel_mm")
        .rotary("travel_deg", real(0.1, 166.0, "deg")).multi_turn(real(0.1, 170_000.0, "deg"))
        .or_text("1.2 times the stroke and twice the release distance");
}

joint_drive "joint.drive" "The drive of a joint." {
    kind = word(&["torque", "step"])
        .is("kind of drive: current-mode amplifier, or step and direction");
    direction = plus_minus().is("-1: the drive moves the joint backwards");
    full_scale = real(0.01, 32_000.0, "N").is("effort of full scale of the 14-bit converter")
        .named("full_scale_n").rotary("full_scale_n_m", real(0.01, 32_000.0, "N m"))
        .only_if("kind", "torque");
    limit = real(0.01, 32_000.0, "N").is("largest effort that is commanded").named("limit_n")
        .rotary("limit_n_m", real(0.01, 32_000.0, "N m")).only_if("kind", "torque")
        .bounded("at most the full scale");
    steps_per_turn = whole(1, 10_000_000, "steps").is("steps per motor turn")
        .only_if("kind", "step");
    ticks_per_us = whole(1, 1000, "ticks/us").is("step clock of the board")
        .only_if("kind", "step");
    pulse_us = real(0.01, 1000.0, "us").is("width of a pulse, and least time between two")
        .only_if("kind", "step")
        .bounded("half a tick to 65535 ticks; the pulse rate reaches the joint's rate");
    setup_us = real(0.0, 1000.0, "us").is("time of a direction level before the first pulse")
        .only_if("kind", "step")
        .bounded("two pulses, setup and hold together shorter than the control period");
    hold_us = real(0.0, 1000.0, "us").is("time of a direction level after the last pulse")
        .only_if("kind", "step");
    lost = real(0.0, 100.0, "mm").is("difference of steps and encoder that is a loss of steps")
        .named("lost_mm").rotary("lost_deg", real(0.0, 30.0, "deg")).only_if("kind", "step")
        .bounded("at least 2 steps").only(super::ENCODER);
    keeps_position = flag()
        .is("the joint cannot move while its drive is off or without power, and the drive keeps its electrical angle; otherwise the position is lost then")
        .or_text("false").only_if("kind", "step").only("joints without an encoder");
}

joint_tmc2209 "joint.drive.tmc2209" "The chip of a step drive that the board sets by its UART; without it the drive is set by switches." {
    address = whole(0, 3, "").is("address by the pins of the chip: 1 for MS1 high, and 2 for MS2 high")
        .bounded("another one for each joint");
    microsteps = whole(1, 256, "").is("microsteps of a full step")
        .bounded("a power of two; with the full steps they are `steps_per_turn`");
    full_steps_per_turn = whole(4, 10_000, "steps").is("full steps per motor turn").or(200.0);
    run_current_a = real(0.01, 2.0, "A").is("rms current of the moving motor; the chip is set to its largest current step that does not exceed it")
        .bounded("0.004 V to 0.2298 V divided by the sense resistor plus 0.02 ohm");
    hold_current_a = real(0.0, 2.0, "A").is("rms current at standstill; its least step is 1/32 of the range")
        .bounded("at most the run current");
    sense_resistor_ohm = real(0.05, 1.0, "ohm").is("sense resistors of the module").or(0.11);
}

joint_tmc5160 "joint.drive.tmc5160" "The chip of a step drive that the board sets by SPI, in a chain of such chips; without it the drive is set by switches." {
    position = whole(0, 4, "").is("position in the chain; 0 is the chip whose SDI is at the board")
        .bounded("another one for each joint, without a gap from 0 on");
    microsteps = whole(1, 256, "").is("microsteps of a full step")
        .bounded("a power of two; with the full steps they are `steps_per_turn`");
    full_steps_per_turn = whole(4, 10_000, "steps").is("full steps per motor turn").or(200.0);
    run_current_a = real(0.01, 20.0, "A").is("rms current of the moving motor; the chip gets the largest one of its steps up to it")
        .bounded("0.0287 V to 0.2298 V divided by the sense resistor");
    hold_current_a = real(0.0, 20.0, "A").is("rms current at standstill; its least step is 1/32 of the run current")
        .bounded("at most the run current");
    sense_resistor_ohm = real(0.01, 1.0, "ohm").is("sense resistors of the module").or(0.075);
}

joint_law "joint.law" "The servo loop of a joint (docs/control.md 3.1 and 3.2)." {
    form = word(&["model", "pd"]).is("model-based or PD");
    kp = real(1.0, 4e6, "1/s^2").is("K_P, position gain")
        .bounded("stable at the control period, with a margin of two in the damping");
    kd = real(0.0, 1e5, "1/s").is("K_D, rate gain")
        .bounded("above 0, K_D times the period below 1");
    ki = real(0.0, 1.6e7, "1/s^3").is("K_I, integral gain").or(0.0).bounded("below K_P K_D / 4");
    friction_adaptation_ms = real(0.0, 60_000.0, "ms")
        .is("time constant with which the integrator of a moving joint is transferred to its friction \
             estimate; 0: no adaptation")
        .or(0.0).bounded("needs ki");
    rate_filter_ms = real(0.0, 60.0, "ms").is("filter of the rate of the error").or(0.0)
        .bounded("to 50 for the controller");
    inertia = real(0.001, 10_000.0, "kg").is("inertia of all that the joint moves")
        .named("inertia_kg").rotary("inertia_kg_m2", real(0.001, 10_000.0, "kg m^2"))
        .bounded("the drive reaches the acceleration with it");
    viscous = real(0.0, 1_000.0, "N per mm/s").is("viscous friction").named("viscous_n_per_mm_s")
        .rotary("viscous_n_m_per_deg_s", real(0.0, 1_000.0, "N m per deg/s")).or(0.0);
    coulomb = real(0.0, 32_000.0, "N").is("Coulomb friction that is compensated")
        .named("coulomb_n").rotary("coulomb_n_m", real(0.0, 32_000.0, "N m")).or(0.0);
    coulomb_rate = real(0.001, 2000.0, "mm/s")
        .is("rate v_k of (C18): the friction compensation is tanh(1) = 76 % there, and full from five \
             times this rate").named("coulomb_rate_mm_s")
        .rotary("coulomb_rate_deg_s", real(0.001, 179.0, "deg/s")).multi_turn(super::MULTI_TURN_RATES);
}

planner "planner" "How the planner joins the blocks of a program." {
    corner_tolerance_mm = real(0.0, 1.0, "mm")
        .is("largest distance of the path from the programmed one, at corners and where short \
             lines are joined; 0 stops at every corner");
    corner_tolerance_deg = real(0.0, 1.0, "deg").is("the same for rotary coordinates");
    curvature_step = real(0.0, 1.0, "")
        .is("change of the acceleration where a line meets an arc, as a fraction of its limit");
    longest_span_ms = real(1.0, 1000.0, "ms").is("longest segment duration, the time between two setpoints, during motion");
    shortest_span_ms = real(0.2, 1000.0, "ms").is("shortest segment duration")
        .bounded("at most the longest");
}

spindle "spindle" "Speeds of the spindle; optional." {
    min_rpm = whole(0, 32_767, "rev/min")
        .is("slowest speed, clockwise and counter-clockwise; a program with a slower speed other than 0 is refused")
        .or(0.0).bounded("at most max_rpm");
    max_rpm = whole(1, 32_767, "rev/min").is("fastest speed; a program with a faster one is refused")
        .or(32_767.0);
    run_up_s = real(0.0, 60.0, "s")
        .is("run-up time, from standstill to the speed: the wait of `run --from-line` and between the parts of a program with probe moves; elsewhere a program waits with G4")
        .or(5.0);
}

compensation "compensation" "Volumetric compensation: the controller corrects the known geometric errors of three linear axes." {
    chain = text("letters w and t with the axes between them and b").is(
        "order of the bodies from the workpiece to the tool, such as \"wYbXZt\"",
    );
    errors = text("the text of an error file (docs/volumetric.md)")
        .is("measured errors; a file of a calibration is added with `--errors FILE`");
    x_measured_at_mm = list(3, -1000.0, 1000.0, "mm")
        .is("work point of the tool while the x axis was measured").or_text("the origin");
    y_measured_at_mm = list(3, -1000.0, 1000.0, "mm")
        .is("the same for the y axis").or_text("the origin");
    z_measured_at_mm = list(3, -1000.0, 1000.0, "mm")
        .is("the same for the z axis").or_text("the origin");
}

stopping "stopping" "The controlled stop along the path." {
    time_ms = whole(5, 2000, "ms").is("time of a controlled stop, whatever the rate")
        .bounded("rate / (time_ms - ramp_ms) at most 4 times the acceleration of each coordinate");
    ramp_ms = whole(1, 1000, "ms")
        .is("part of that time in which the deceleration builds up, and in which it decays")
        .bounded("at most half of time_ms");
}

supervision "supervision" "Limits of the controller's monitors." {
    heartbeat_ms = whole(20, 5000, "ms")
        .is("longest silence of the host while the machine is active");
    missed_periods = whole(1, 50, "periods")
        .is("missed control periods in a row that are a fault");
    illegal_transitions = whole(1, 1000, "")
        .is("illegal transitions of an encoder since enable that are a fault")
        .only("role = \"machine\"");
    singularity_margin_mm = real(1.0, 200.0, "mm")
        .is("least distance from the singularity of the model; poses nearer to it are refused, and jogs stop before them")
        .only("models with a singularity")
        .bounded("shorter than rods and links; a model may have a lower bound");
}

homing "homing" "The search for the index pulses; only where a joint has home = \"index\"." {
    rate_mm_s = real(0.01, 200.0, "mm/s")
        .is("rate of the search of linear joints, or of the coordinate that moves them; an index pulse is found once, without a second touch")
        .only("machines with a linear joint that homes by index");
    rate_deg_s = real(0.01, 90.0, "deg/s")
        .is("rate of the search of rotary joints")
        .only("machines with a rotary joint that homes by index");
}

force "force" "Force sensor and force control; a machine without a force sensor has no such section." {
    under_control = words(&["x", "y", "z"])
        .is("axes under force control when the controller is configured; leave it empty")
        .or_text("[]");
    slowest_rpm = whole(0, 30_000, "rev/min")
        .is("slowest spindle at which force control works; sets the window of the peak force. 0 is \
             a tool without teeth: the window is 2 ms")
        .bounded("0, or 147 or more at 200 us");
    drive_lag_ms = real(0.0, 60.0, "ms").is("lag of the tool behind its reference");
    creep_mm_s = real(0.0, 1.0, "mm/s").is("creep rate; 0 for drives without friction")
        .bounded("above coulomb_rate_mm_s, and above backlash_mm in a second");
}

force_sensor "force.sensor" "The force sensor." {
    converter_v = real(0.1, 100.0, "V").is("range of the 14-bit converter, positive and negative");
    saturation_part = real(0.1, 0.999, "")
        .is("fraction of the range beyond which a channel is saturated");
    silent_ms = real(0.1, 1000.0, "ms").is("longest time without a new sample");
    stuck_ms = real(0.0, 3000.0, "ms")
        .is("time of one value after which a channel is stuck; 0 for a sensor without noise");
    tare_ms = real(5.0, 1500.0, "ms").is("length of a tare")
        .bounded("16 to 32768 control periods");
    tare_spread_codes = whole(1, 8192, "codes").is("largest spread of codes during a tare");
    drift_n = real(0.01, 1000.0, "N").is("largest mean force while nothing touches the tool");
    limit_n = real(0.1, 2048.0, "N").is("force beyond which the machine stops");
    weight_n = real(0.0, 2048.0, "N")
        .is("weight of vise and workpiece, which turns with the table");
}

force_axis "force.axis" "The force loop of x, y or z." {
    name = text("\"x\", \"y\", \"z\", in this order").is("axis");
    newtons_per_volt = real(1e-3, 4000.0, "N/V").is("scale of the channel")
        .bounded("at most 0.5 N per code");
    sign = plus_minus().is("sign of the channel, so that its value is the force on the tool");
    setpoint_n = real(-2048.0, 2048.0, "N").is("force setpoint f_d")
        .bounded("magnitude 0.5 to three quarters of the sensor range");
    mass_n_s2_per_mm = real(0.0, 65_535.0, "N s^2/mm").is("virtual mass K_A")
        .bounded("by damping, period and sensor range");
    damping_n_s_per_mm = real(0.0, 65_535.0, "N s/mm").is("virtual damping K_V")
        .bounded("by mass, period and lag, to 1024");
    limit_mm = real(-64.0, 1000.0, "mm").is("compliance limit").bounded("above 0 to 64");
    rate_mm_s = real(-2000.0, 2000.0, "mm/s").is("maximum rate of the compliant displacement")
        .bounded("above 0");
    enable_condition = word(&["against_motion", "any", "positive", "negative"])
        .is("enable condition: when a force displaces the tool");
}

}
