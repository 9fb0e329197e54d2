//! What a board can drive, compared with a machine.

use super::{BOARDS, Board};
use crate::{Error, ErrorKind};
use haptimill_firmware::config::{ChipKind, Drive as JointDrive, Home};
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::model::Model;
use haptimill_machine_file::scale::{PER_COUNT, per_unit};

impl Board {
    /// Checks that it can drive a machine.
    ///
    /// # Errors
    /// The first joint, input or other part that it does not have or cannot drive, the key, and
    /// what to do.
    pub fn check_machine(&self, machine: &MachineFile) -> Result<(), Error> {
        self.check_joints(machine)?;
        let refused = |what: String| {
            let what = format!("{}: {what} ({})", machine.file, self.title);
            Err(Error::new(ErrorKind::BadInput, what))
        };
        let config = &machine.config;
        if let Some(problem) = self.channels(machine) {
            return refused(problem);
        }
        if let Some(problem) = self.chips(machine) {
            return refused(problem);
        }
        if config.force.is_some() {
            return refused("the board has no force sensor; remove [force]".to_string());
        }
        if config.haptic.is_some() {
            return refused("the board has no haptic arm; remove [haptic]".to_string());
        }
        if !self.periods.contains(&config.period_us) {
            let periods: Vec<String> = self.periods.iter().map(ToString::to_string).collect();
            return refused(format!(
                "period_us = {}, but an image of the board has a control period of {} us; set it \
                 to one of them",
                config.period_us,
                periods.join(", ")
            ));
        }
        Ok(())
    }

    /// The first joint with a chip, if the board has no bus for it.
    fn chips(&self, machine: &MachineFile) -> Option<String> {
        let (name, kind) = first_chip(machine)?;
        if self.chips == Some(kind) {
            return None;
        }
        let others = BOARDS.iter().filter(|board| board.chips == Some(kind));
        let others: Vec<&str> = others.map(|board| board.name).collect();
        Some(format!(
            "joint {name}: {}: the board has no bus for these chips; set them by their pins and \
             remove the section, or take a board with the bus ({})",
            section(kind),
            others.join(", ")
        ))
    }

    /// The first input or output that the board does not have.
    fn channels(&self, machine: &MachineFile) -> Option<String> {
        let (inputs, outputs) = self.digital;
        let (io, names) = (&machine.config.io, &machine.io);
        let input = io.inputs.iter().zip(&names.inputs);
        let input = input.map(|(it, name)| ("input", "inputs", it.channel, inputs, name));
        let output = io.outputs.iter().zip(&names.outputs);
        let output = output.map(|(it, name)| ("output", "outputs", it.channel, outputs, name));
        let missing = input.chain(output).find(|it| it.2 >= it.3);
        if let Some((one, all, channel, count, name)) = missing {
            if count == 0 {
                return Some(format!(
                    "{one} {name}: the board has no digital {all}; remove it, or take another board"
                ));
            }
            let own = match count {
                0..=2 => {
                    let own: Vec<String> = (0..count).map(|channel| channel.to_string()).collect();
                    own.join(" and ")
                }
                _ => format!("0 to {}", count - 1),
            };
            return Some(format!(
                "{one} {name}: channel = {channel}, but the digital {all} of the board have \
                 channel {own}; use one of them, or remove it"
            ));
        }
        let analog = names.analog_inputs.first().map(|it| ("input", it));
        let analog = analog.or_else(|| names.analog_outputs.first().map(|it| ("output", it)));
        analog.map(|(one, analog)| {
            let name = &analog.name;
            format!("[[analog_{one}]] {name}: the board has no analog {one}s; remove it")
        })
    }

    /// Checks the joints of a machine.
    fn check_joints(&self, machine: &MachineFile) -> Result<(), Error> {
        let (joints, ticks) = self.step_drives;
        let model = Model::new(machine);
        let names = model.joint_names();
        for (joint, config) in machine.config.joints.iter().enumerate() {
            let what = match config.drive {
                _ if joint >= joints => format!("the board has {joints} drives"),
                JointDrive::Torque { .. } => "the board has no torque drives".to_string(),
                JointDrive::Steps { ticks_per_us, .. } if ticks_per_us != ticks => format!(
                    "ticks_per_us = {ticks_per_us}, but the step clock of the board has {ticks}; \
                     change it here and below [plant]"
                ),
                JointDrive::Steps { pulse, setup, .. }
                    if pulse % self.slot_ticks != 0 || setup % self.slot_ticks != 0 =>
                {
                    format!(
                        "pulse_us and setup_us of the board are multiples of {}; change them",
                        f64::from(self.slot_ticks) / f64::from(ticks)
                    )
                }
                JointDrive::Steps { .. } if config.encoder.is_some() && joint >= self.encoders => {
                    match self.encoders {
                        0 => "the board has no encoder inputs; remove its encoder, or take the \
                              image with encoders (`haptimill flash pico2-encoders`)"
                            .to_string(),
                        count => format!(
                            "the board has encoder inputs for {count} joints; remove the encoder \
                             of this one"
                        ),
                    }
                }
                JointDrive::Steps { .. }
                    if !self.has_index_pulses
                        && matches!(config.home, Home::Index | Home::SwitchAndIndex(_)) =>
                {
                    let home = match config.home {
                        Home::Index => "index",
                        _ => "switch_and_index",
                    };
                    format!(
                        "home = \"{home}\", but the board has no inputs for index pulses; set \
                         home = \"switch\" with [joint.switch], or home = \"none\""
                    )
                }
                JointDrive::Steps { .. }
                    if config.needs_limit_switches() && !self.has_limit_switches =>
                {
                    "the board has no inputs for limit switches; search the home switch, and leave \
                     limit_low_active and limit_high_active out, or take the image with encoders \
                     (`haptimill flash pico2-encoders`)"
                        .to_string()
                }
                JointDrive::Steps { per_step, .. } => {
                    let Some(limits) = machine.joints.get(joint) else {
                        continue;
                    };
                    let step = per_step.unsigned_abs() as f64 / PER_COUNT / per_unit(config.kind);
                    let rate = limits.rate / step;
                    if rate <= f64::from(self.step_rate) {
                        continue;
                    }
                    format!(
                        "its rate is {rate:.0} steps/s, but a joint of the board makes at most {}; \
                         lower the rate of the joint, or steps_per_turn and the microsteps of its \
                         drive",
                        self.step_rate
                    )
                }
            };
            let file = &machine.file;
            let name = names.get(joint).copied().unwrap_or("?");
            let what = format!("{file}: joint {name}: {what} ({})", self.title);
            return Err(Error::new(ErrorKind::BadInput, what));
        }
        Ok(())
    }

    /// Checks that an image can set the chips of the drives of a machine: one whose line to the
    /// host is the USB leaves the pins of their bus free.
    ///
    /// # Errors
    /// The first joint with a chip, and what to do.
    pub fn check_image(&self, machine: &MachineFile, image: &[u8]) -> Result<(), Error> {
        let Some((name, kind)) = first_chip(machine) else {
            return Ok(());
        };
        if self.usb.is_none() || self.of_image(image).is_some() {
            return Ok(());
        }
        let what = format!(
            "{}: joint {name}: {}: the image has its line to the host at the pins of the bus of \
             these chips; take the image with the USB, or remove the section ({})",
            machine.file,
            section(kind),
            self.title
        );
        Err(Error::new(ErrorKind::BadInput, what))
    }
}

/// Name of the first joint with a chip that the board sets, and its kind.
fn first_chip(machine: &MachineFile) -> Option<(&str, ChipKind)> {
    let joints = machine.config.joints.iter().zip(&machine.joints);
    let mut chips = joints.filter_map(|(joint, limits)| Some((limits, joint.chip()?)));
    let (limits, chip) = chips.next()?;
    Some((limits.name.as_str(), chip.kind))
}

/// The section of a machine file with a chip.
const fn section(kind: ChipKind) -> &'static str {
    match kind {
        ChipKind::Tmc2209 => "[joint.drive.tmc2209]",
        ChipKind::Tmc5160 => "[joint.drive.tmc5160]",
    }
}

#[cfg(test)]
mod tests;
