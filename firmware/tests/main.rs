//! Integration tests, as one binary because it builds faster than many. Tests of one module:
//! `cargo test -p haptimill-firmware --test all admittance`.

mod admittance;
mod arm;
mod contact;
mod contact_stability;
mod feedback_law;
mod feedback_loop;
mod force_control;
mod force_sensor;
mod haptics;
mod integrity;
mod joint;
mod joint_encoder;
mod joint_index;
mod joint_monitor;
mod joint_rates;
mod joint_step_gen;
mod kinematics_conformance;
mod kinematics_facet;
mod kinematics_golden;
mod kinematics_haptic;
mod kinematics_machine;
mod motion;
mod named_io;
mod override_mode;
mod path;
mod receive;
mod reference;
mod safety;
mod servo;
mod standstill;
mod step_overflow;
mod switch_search;
mod tracker;
mod volumetric;
mod window_peak;
