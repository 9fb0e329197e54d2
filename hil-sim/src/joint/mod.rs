//! One simulated joint: motor, screw, slide, encoder and drive.

pub mod config;
pub mod encoder;
pub mod gantry;
pub mod mechanics;
pub mod stepper;
pub mod switch;

pub use config::{
    DriveConfig, EncoderConfig, EncoderPlace, JointConfig, JointKind, StepDrive, SwitchConfig,
    SwitchSide, TorqueDrive,
};
