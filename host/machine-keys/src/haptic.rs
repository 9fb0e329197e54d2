//! Keys of haptic arm and following.

use crate::key::sections;

sections! {

follow "follow" "Motion of the tool by a remote master; optional." {
    scale = real(0.1, 2.0, "")
        .is("position scale G_P: motion of the tool per motion of the master");
    gain_per_s = whole(10, 500, "1/s").is("gain k of (C2): the tool follows through two first-order stages of 1/k");
    stale_ms = whole(5, 1000, "ms").is("largest age of the newest master pose");
}

haptic "haptic" "The haptic arm; optional." {
    illegal_transitions = whole(0, 1000, "")
        .is("illegal transitions of an encoder that are a fault");
    condition = whole(2, 1000, "").is("largest condition number of the statics");
    rate_filter_ms = real(0.5, 20.0, "ms").is("filter of the rates of the handle");
    tip_ball_mm = real(0.0, 50.0, "mm")
        .is("diameter of the ball at the tip; virtual fixtures leave it room");
    force_step_n = real(1e-4, 0.05, "N").is("largest change of the feedback force per control period");
}

geometry "haptic.geometry" "Lengths of the haptic arm." {
    base_radius_mm = real(10.0, 400.0, "mm").is("radius of the base r_b");
    platform_radius_mm = real(10.0, 400.0, "mm").is("radius of the platform r_p");
    link_mm = real(10.0, 400.0, "mm").is("length of a link L");
    tilt_deg = real(-79.9, 79.9, "deg").is("theta2; theta1 is 0, 120 and 240 degrees");
    tip_x_mm = real(-400.0, 400.0, "mm").is("tip from the centre of the platform, in x");
    tip_y_mm = real(-400.0, 400.0, "mm").is("the same in y");
    tip_z_mm = real(-400.0, 400.0, "mm").is("the same in z");
    side_tolerance_mm = real(0.001, 50.0, "mm")
        .is("tolerance of a side of the platform; a larger deviation is an encoder fault")
        .bounded("below an eighth of the platform radius");
}

range "haptic.range" "Ranges of the joints of a leg." {
    slide_low_mm = real(-800.0, 800.0, "mm").is("lower end of the slide d");
    slide_high_mm = real(-800.0, 800.0, "mm").is("upper end of the slide d");
    turn_low_deg = real(-179.0, 179.0, "deg").is("lower end of theta3, the turn about the slide");
    turn_high_deg = real(-179.0, 179.0, "deg").is("upper end of theta3");
    hinge_low_deg = real(-179.0, 179.0, "deg").is("lower end of theta4, the angle of the link");
    hinge_high_deg = real(-179.0, 179.0, "deg").is("upper end of theta4");
}

leg "haptic.leg" "Encoders and amplifiers of a leg; three sections." {
    slide_counts_per_mm = real(-1e6, 1e6, "counts/mm")
        .is("counts of the slide's encoder; negative: counts backwards").bounded("not 0");
    slide_home_mm = real(-800.0, 800.0, "mm").is("slide at home").bounded("within its range");
    turn_counts_per_turn = real(-1e8, 1e8, "counts/turn").is("counts of the encoder of theta3")
        .bounded("not 0");
    turn_home_deg = real(-179.0, 179.0, "deg").is("theta3 at home").bounded("within its range");
    hinge_counts_per_turn = real(-1e8, 1e8, "counts/turn").is("counts of the encoder of theta4")
        .bounded("not 0");
    hinge_home_deg = real(-179.0, 179.0, "deg").is("theta4 at home").bounded("within its range");
    slide_full_scale_n = real(-30_000.0, 30_000.0, "N")
        .is("force of full scale of the slide; negative: wired in reverse")
        .bounded("not 0");
    slide_limit_n = real(1e-3, 30_000.0, "N").is("largest force of the slide that is commanded")
        .bounded("at most the full scale");
    turn_full_scale_n_mm = real(-30_000.0, 30_000.0, "N mm").is("moment of full scale of theta3")
        .bounded("not 0");
    turn_limit_n_mm = real(1e-3, 30_000.0, "N mm")
        .is("largest moment of theta3 that is commanded").bounded("at most the full scale");
}

feedback "haptic.feedback" "The force feedback law." {
    x_percent = whole(0, 100, "%").is("force feedback in x, percentage of the force on the tool");
    x_limit_n = real(0.0, 10.0, "N").is("limit of the force feedback in x");
    y_percent = whole(0, 100, "%").is("the percentage in y");
    y_limit_n = real(0.0, 10.0, "N").is("the limit in y");
    z_percent = whole(0, 100, "%").is("the percentage in z");
    z_limit_n = real(0.0, 10.0, "N").is("the limit in z");
    damping_n_s_per_mm = real(0.0, 0.99, "N s/mm").is("velocity-proportional damping term");
    damping_below_n = real(0.5, 10.0, "N").is("force feedback below which the damping term acts");
}

fixture "haptic.fixture" "Virtual fixtures." {
    stiffness_n_per_mm = real(0.05, 2.0, "N/mm").is("stiffness of a virtual fixture");
    limit_n = real(0.5, 10.0, "N").is("limit of its force");
}

passivity "haptic.passivity" "The passivity observer and controller." {
    surplus_n_mm = real(0.0, 100.0, "N mm")
        .is("largest energy surplus, without the energy of the virtual fixtures");
    deficit_n_mm = real(0.01, 100.0, "N mm").is("energy deficit E_d of (C26)");
    damping_n_s_per_mm = real(0.0, 0.5, "N s/mm").is("damping B_h of the passivity controller, below (C26)");
}

}
