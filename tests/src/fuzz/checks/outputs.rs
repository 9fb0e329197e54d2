//! Outputs: drives, haptic arm and spindle are safe in every state.

use super::super::bench::FuzzBench;
use super::{CheckResult, Checks, limits};
use haptimill_firmware::config::Drive;
use haptimill_firmware::io::{DriveCommand, HapticOutputs};
use haptimill_firmware::machine::Machine;
use haptimill_protocol::message::{Fault, State};

/// Returns whether a fault is one for which the machine brakes and holds its position.
///
/// The list is the fuzz test's own, independent of the firmware's.
const fn holds(fault: &Fault) -> bool {
    matches!(
        fault,
        Fault::LostHost { .. }
            | Fault::MissedPeriods { .. }
            | Fault::SoftLimit { .. }
            | Fault::JointRate { .. }
            | Fault::Force(_)
            | Fault::Master(_)
            | Fault::ProbeContact { .. }
    )
}

impl Checks {
    /// Checks the outputs of this period against state and inputs.
    pub(super) fn check_outputs(&self, bench: &FuzzBench) -> CheckResult {
        let controller = bench.controller();
        let (safety, outputs, inputs) =
            (controller.safety(), bench.rig.outputs(), bench.rig.inputs());
        let state = safety.state();
        let on = outputs
            .joints
            .iter()
            .any(|joint| *joint != DriveCommand::Off);
        let haptic = outputs.haptic != HapticOutputs::default();
        let all_off = !on && !haptic && outputs.spindle_rpm == 0;
        let holding = state == State::Fault && safety.fault().is_some_and(|fault| holds(&fault));
        let permitted = match state {
            State::Disabled | State::EmergencyStop => false,
            State::Fault => holding,
            _ => true,
        };
        if !permitted && !all_off {
            violated!(
                bench,
                "outputs not safe",
                "state {state:?}, fault {:?}, drives {:?}, spindle {}, haptic {haptic}",
                safety.fault(),
                outputs.joints,
                outputs.spindle_rpm
            );
        }
        if inputs.emergency_stop && (state != State::EmergencyStop || !all_off) {
            violated!(
                bench,
                "emergency stop",
                "the circuit is open in state {state:?}"
            );
        }
        if (state == State::Fault) != safety.fault().is_some() && state != State::EmergencyStop {
            violated!(bench, "fault", "{state:?} with {:?}", safety.fault());
        }
        if outputs.spindle_rpm != 0 && !matches!(state, State::Run | State::Hold) {
            violated!(
                bench,
                "spindle",
                "{} rev/min in {state:?}",
                outputs.spindle_rpm
            );
        }
        match controller.machine() {
            Some(machine) => self.check_drives(bench, machine, on)?,
            None if on => violated!(
                bench,
                "outputs not safe",
                "drives on without a configuration"
            ),
            None => {}
        }
        if inputs.out_of_band_stop && state == State::Run {
            violated!(bench, "out-of-band stop", "the job continues");
        }
        Ok(())
    }

    fn check_drives(&self, bench: &FuzzBench, machine: &Machine, on: bool) -> CheckResult {
        let (outputs, inputs) = (bench.rig.outputs(), bench.rig.inputs());
        // A joint moves off the switch on which it stood when the drives were off.
        let leaves = machine.is_moving_off() || self.previous.is_moving_off;
        let ignored = if leaves {
            self.previous.limits_with_drives_off
        } else {
            [0; 6]
        };
        let joints = inputs
            .joints
            .iter()
            .zip(limits(&inputs.joints))
            .zip(ignored);
        let bad = joints
            .take(machine.joint_count())
            .any(|((axis, limits), ignored)| limits & !ignored != 0 || !axis.drive_ready);
        if bad && on && self.previous.drives_on {
            violated!(
                bench,
                "limit or drive ignored",
                "drives on in {:?} with {:?}",
                bench.controller().safety().state(),
                &inputs.joints
            );
        }
        for (joint, axis) in machine.config.joints.iter().enumerate() {
            match (&axis.drive, outputs.joints[joint]) {
                (_, DriveCommand::Off) => {
                    if on {
                        violated!(bench, "drive off", "joint {joint} alone is off");
                    }
                }
                (Drive::Torque { full_scale, limit }, DriveCommand::Torque(code)) => {
                    let max = f64::from(limit.0) / f64::from(full_scale.0).abs() * 8192.0;
                    if f64::from(code).abs() > max + 1.0 {
                        violated!(
                            bench,
                            "effort",
                            "joint {joint}: code {code} of at most {max}"
                        );
                    }
                }
                (Drive::Steps { .. }, DriveCommand::Steps(_)) => {}
                (_, command) => {
                    violated!(bench, "drive kind", "joint {joint}: {command:?}");
                }
            }
            if let Some(report) = bench.rig.plant().pulse_report(joint)
                && report.violations > 0
                && !self.foreign_configuration
            {
                violated!(bench, "pulses", "joint {joint}: {:?}", report.first);
            }
        }
        Ok(())
    }
}
