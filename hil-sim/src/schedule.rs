//! Schedule of the injected faults of a run.
//!
//! A schedule with faults owns the conditions of all devices. It sets all of them at each change,
//! which overwrites conditions set by other code.

use crate::contact::InputCondition;
use crate::fault::{
    Channel, Direction, Fault, FaultError, FaultKind, HapticEncoder, HapticFault, Level,
};
use crate::haptics::sensors::SENSORS;
use crate::joint::encoder::EncoderCondition;
use crate::line::{LineCondition, SerialLine};
use crate::plant::{JointCondition, Plant};
use crate::process::sensor::{End, SensorCondition};
use haptimill_firmware::io::LEGS;
use haptimill_protocol::message::MAX_AXES;

/// A fault with its times and its state.
#[derive(Debug, Clone)]
struct Entry {
    kind: FaultKind,
    /// Index of the fault's joint or input.
    place: usize,
    begins_ns: u64,
    ends_ns: u64,
    active: bool,
}

/// All faults of a run.
#[derive(Debug, Clone)]
pub struct Schedule {
    entries: Vec<Entry>,
    /// Time of the next change, ns.
    next_ns: u64,
    /// Number of periods still to be missed.
    misses: u32,
}

impl Schedule {
    /// Creates the schedule of these faults for a machine with these joints and digital inputs.
    ///
    /// # Errors
    /// The first fault that is invalid for the machine.
    pub fn new(faults: &[Fault], joints: &[&str], inputs: &[&str]) -> Result<Self, FaultError> {
        let mut entries = Vec::new();
        for fault in faults {
            let place = fault.place(joints, inputs)?;
            let begins_ns = (fault.at_s * 1e9) as u64;
            let ends_ns = fault
                .for_s
                .map_or(u64::MAX, |time| begins_ns + (time * 1e9) as u64);
            entries.push(Entry {
                kind: fault.what.clone(),
                place,
                begins_ns,
                ends_ns,
                active: false,
            });
        }
        let next_ns = if entries.is_empty() { u64::MAX } else { 0 };
        Ok(Self {
            entries,
            next_ns,
            misses: 0,
        })
    }

    /// Sets the state of all devices at `now`. Returns true when the controller misses the period
    /// that begins.
    pub fn apply(
        &mut self,
        now: u64,
        plant: &mut Plant,
        to_machine: &mut SerialLine,
        to_host: &mut SerialLine,
    ) -> bool {
        if now >= self.next_ns {
            self.change(now, plant, to_machine, to_host);
        }
        let miss = self.misses > 0;
        self.misses = self.misses.saturating_sub(1);
        miss
    }

    fn change(
        &mut self,
        now: u64,
        plant: &mut Plant,
        to_machine: &mut SerialLine,
        to_host: &mut SerialLine,
    ) {
        self.next_ns = u64::MAX;
        let mut joints = [JointCondition::default(); MAX_AXES];
        let mut encoders = [EncoderCondition::default(); MAX_AXES];
        let mut loads = [0.0; MAX_AXES];
        let mut emergency_stop = false;
        let mut wires = [LineCondition::HEALTHY; 2];
        let mut sensors = [SensorCondition::default(); 3];
        let mut stalled = false;
        let mut haptic = HapticCondition::default();
        let mut inputs = vec![InputCondition::default(); plant.inputs().count()];
        for entry in &mut self.entries {
            let begins = !entry.active && now >= entry.begins_ns;
            entry.active = (entry.begins_ns..entry.ends_ns).contains(&now);
            for edge in [entry.begins_ns, entry.ends_ns] {
                if edge > now {
                    self.next_ns = self.next_ns.min(edge);
                }
            }
            match entry.kind {
                FaultKind::EncoderSlip { counts, .. } if begins && entry.begins_ns != u64::MAX => {
                    plant.slip_encoder(entry.place, counts);
                    entry.begins_ns = u64::MAX;
                }
                FaultKind::HapticArm(HapticFault::EncoderSlip { place, counts })
                    if begins && entry.begins_ns != u64::MAX =>
                {
                    if let Some(arm) = plant.haptic_mut() {
                        let (leg, sensor) = index(place);
                        arm.slip_encoder(leg, sensor, counts);
                    }
                    entry.begins_ns = u64::MAX;
                }
                FaultKind::MissedPeriods { count } if begins && entry.begins_ns != u64::MAX => {
                    self.misses = self.misses.saturating_add(count);
                    entry.begins_ns = u64::MAX;
                }
                _ => {}
            }
            if entry.active {
                inject_process(&entry.kind, &mut sensors, &mut stalled);
                match entry.kind {
                    FaultKind::InputLevel { level, .. } => {
                        inputs[entry.place].level = Some(level == Level::High);
                    }
                    FaultKind::InputBounce { hz, .. } => inputs[entry.place].bounce_hz = hz,
                    _ => {}
                }
                if let FaultKind::HapticArm(fault) = &entry.kind {
                    inject_haptic(fault, &mut haptic);
                }
                inject(
                    &entry.kind,
                    entry.place,
                    &mut joints,
                    &mut encoders,
                    &mut loads,
                    &mut emergency_stop,
                    &mut wires,
                );
            }
        }
        for joint in 0..plant.axes() {
            plant.set_condition(joint, joints[joint]);
            plant.set_encoder_condition(joint, encoders[joint]);
            plant.set_load(joint, loads[joint]);
        }
        plant.set_emergency_stop(emergency_stop);
        for (input, condition) in inputs.into_iter().enumerate() {
            plant.inputs_mut().set_condition(input, condition);
        }
        if let Some(process) = plant.process_mut() {
            process.spindle_mut().set_stalled(stalled);
            if let Some(sensor) = process.sensor_mut() {
                for (component, condition) in sensors.into_iter().enumerate() {
                    sensor.set_condition(component, condition);
                }
            }
        }
        if let Some(arm) = plant.haptic_mut() {
            arm.set_tripped(haptic.tripped);
            for (leg, encoders) in haptic.encoders.into_iter().enumerate() {
                for (sensor, condition) in encoders.into_iter().enumerate() {
                    arm.set_encoder_condition(leg, sensor, condition);
                }
            }
        }
        to_machine.set_condition(wires[0]);
        to_host.set_condition(wires[1]);
    }
}

/// Adds an active fault to the conditions.
fn inject(
    kind: &FaultKind,
    joint: usize,
    joints: &mut [JointCondition; MAX_AXES],
    encoders: &mut [EncoderCondition; MAX_AXES],
    loads: &mut [f64; MAX_AXES],
    emergency_stop: &mut bool,
    wires: &mut [LineCondition; 2],
) {
    let chosen = |direction: Direction| -> &'static [usize] {
        match direction {
            Direction::Both => &[0, 1],
            Direction::ToMachine => &[0],
            Direction::ToHost => &[1],
        }
    };
    match *kind {
        FaultKind::EncoderStuck {
            channel: Channel::A,
            level,
            ..
        } => {
            encoders[joint].stuck_a = Some(level == Level::High);
        }
        FaultKind::EncoderStuck {
            channel: Channel::B,
            level,
            ..
        } => {
            encoders[joint].stuck_b = Some(level == Level::High);
        }
        FaultKind::EncoderSwapped { .. } => encoders[joint].swapped = true,
        FaultKind::EncoderNoise { per_second, .. } => encoders[joint].noise_hz += per_second,
        FaultKind::IndexMissing { .. } => encoders[joint].index_missing = true,
        FaultKind::DriveDead { .. } => joints[joint].drive_gain = 0.0,
        FaultKind::DriveTripped { .. } => joints[joint].drive_tripped = true,
        FaultKind::DriveWeak { gain, .. } => joints[joint].drive_gain *= gain,
        FaultKind::DriveReversed { .. } => joints[joint].drive_gain *= -1.0,
        FaultKind::JointJammed { effort, .. } => {
            joints[joint].jam += effort.unwrap_or(f64::INFINITY)
        }
        FaultKind::Push { effort, .. } => loads[joint] += effort,
        FaultKind::SwitchStuck { switch, active, .. } => {
            joints[joint].switches[switch as usize].stuck = Some(active);
        }
        FaultKind::SwitchInverted { switch, .. } => {
            joints[joint].switches[switch as usize].inverted = true;
        }
        FaultKind::SwitchMissing { switch, .. } => {
            joints[joint].switches[switch as usize].missing = true;
        }
        FaultKind::SwitchBounces { switch, ms, .. } => {
            joints[joint].switches[switch as usize].bounce_ms += ms;
        }
        FaultKind::EmergencyStop => *emergency_stop = true,
        FaultKind::LinkErrors { rate, direction } => {
            chosen(direction)
                .iter()
                .for_each(|&wire| wires[wire].bit_error_rate = rate);
        }
        FaultKind::LinkDrop { rate, direction } => {
            chosen(direction)
                .iter()
                .for_each(|&wire| wires[wire].drop_rate = rate);
        }
        FaultKind::LinkDuplicate { rate, direction } => {
            chosen(direction)
                .iter()
                .for_each(|&wire| wires[wire].duplicate_rate = rate);
        }
        FaultKind::LinkDelay { ms, direction } => {
            chosen(direction)
                .iter()
                .for_each(|&wire| wires[wire].delay_ns = (ms * 1e6) as u64);
        }
        FaultKind::LinkCut { direction } => chosen(direction)
            .iter()
            .for_each(|&wire| wires[wire].cut = true),
        FaultKind::EncoderSlip { .. }
        | FaultKind::MissedPeriods { .. }
        | FaultKind::SensorStuck { .. }
        | FaultKind::SensorDropped { .. }
        | FaultKind::SensorReversed { .. }
        | FaultKind::SensorDrift { .. }
        | FaultKind::SensorSaturated { .. }
        | FaultKind::HapticArm(_)
        | FaultKind::InputLevel { .. }
        | FaultKind::InputBounce { .. }
        | FaultKind::SpindleStalled => {}
    }
}

/// Injected faults of the haptic arm.
#[derive(Default)]
struct HapticCondition {
    encoders: [[EncoderCondition; SENSORS]; LEGS],
    tripped: bool,
}

/// Indices of leg and sensor, from 0.
fn index(place: HapticEncoder) -> (usize, usize) {
    // [`Fault::place`] has checked the range.
    let leg = usize::from(place.leg.saturating_sub(1)).min(LEGS - 1);
    (leg, place.sensor as usize)
}

/// Adds an active fault of the haptic arm to its conditions.
fn inject_haptic(fault: &HapticFault, haptic: &mut HapticCondition) {
    let Some(place) = fault.encoder() else {
        haptic.tripped = true;
        return;
    };
    let (leg, sensor) = index(place);
    let encoder = &mut haptic.encoders[leg][sensor];
    match *fault {
        HapticFault::EncoderStuck { channel, level, .. } => {
            let stuck = match channel {
                Channel::A => &mut encoder.stuck_a,
                Channel::B => &mut encoder.stuck_b,
            };
            *stuck = Some(level == Level::High);
        }
        HapticFault::EncoderSwapped(_) => encoder.swapped = true,
        HapticFault::EncoderDropped(_) => {
            encoder.stuck_a = Some(false);
            encoder.stuck_b = Some(false);
        }
        HapticFault::EncoderNoise { per_second, .. } => encoder.noise_hz += per_second,
        HapticFault::EncoderSlip { .. } | HapticFault::AmplifiersTripped => {}
    }
}

/// Adds an active fault of the sensor or the spindle to their conditions.
fn inject_process(kind: &FaultKind, sensors: &mut [SensorCondition; 3], stalled: &mut bool) {
    match *kind {
        FaultKind::SensorStuck { along } => sensors[along as usize].stuck = true,
        FaultKind::SensorDropped { along } => sensors[along as usize].dropped = true,
        FaultKind::SensorReversed { along } => sensors[along as usize].gain *= -1.0,
        FaultKind::SensorDrift { along, rate } => sensors[along as usize].drift_n_s += rate,
        FaultKind::SensorSaturated { along, level } => {
            sensors[along as usize].saturated = Some(match level {
                Level::High => End::High,
                Level::Low => End::Low,
            });
        }
        FaultKind::SpindleStalled => *stalled = true,
        _ => {}
    }
}
