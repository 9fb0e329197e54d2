//! Telemetry streams: when a message of each is due, and what it contains.

use crate::core::Core;
use crate::force::ForceControl;
use crate::io::Inputs;
use haptimill_protocol::message::{Report, Telemetry};

/// Total counts of line events.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LineCount {
    /// Bytes that waited for a later period, summed over the periods.
    pub deferred_bytes: u32,
    /// Frames refused by their CRC.
    pub bad_frames: u32,
    /// Bytes that the board lost because its ring was full.
    pub lost_bytes: u32,
}

/// A telemetry stream.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Stream {
    /// The machine.
    #[default]
    Machine,
    /// The haptic arm.
    Haptic,
}

/// Interval of a stream.
#[derive(Debug, Default)]
struct Interval {
    /// In periods; 0 is off.
    every: u16,
    /// Periods until the next message is due; 0 is never.
    left: u16,
    due: bool,
}

impl Interval {
    #[inline]
    const fn tick(&mut self) {
        if self.left != 0 {
            self.left -= 1;
            if self.left == 0 {
                self.left = self.every;
                self.due = true;
            }
        }
    }
}

/// The telemetry streams of a session.
#[derive(Debug, Default)]
pub struct Streams {
    machine: Interval,
    haptic: Interval,
    /// Stream of the message that the link got last.
    newest: Stream,
    /// That message was withdrawn: reports wait until the next one is transmitted.
    pub(super) superseded: bool,
}

impl Streams {
    const fn interval(&mut self, stream: Stream) -> &mut Interval {
        match stream {
            Stream::Machine => &mut self.machine,
            Stream::Haptic => &mut self.haptic,
        }
    }

    /// Sets the interval of a stream, in periods; 0 is off.
    pub const fn set(&mut self, stream: Stream, every: u16) {
        let interval = self.interval(stream);
        interval.every = every;
        interval.left = every;
    }

    /// Requests telemetry of the machine in this period.
    pub const fn request(&mut self) {
        self.machine.left = 1;
    }

    /// Counts a period; returns the stream that is due. Telemetry of the haptic arm comes after
    /// that of the machine, and never replaces a message that waits.
    #[inline]
    pub(super) const fn tick(&mut self, waits: bool) -> Option<Stream> {
        self.machine.tick();
        self.haptic.tick();
        if self.machine.due {
            Some(Stream::Machine)
        } else if self.haptic.due && !waits {
            Some(Stream::Haptic)
        } else {
            None
        }
    }

    /// The message of a stream was sampled.
    pub(super) const fn sampled(&mut self, stream: Stream) {
        self.interval(stream).due = false;
        self.newest = stream;
    }

    /// The message sampled last was withdrawn.
    pub(super) const fn sample_again(&mut self) {
        self.interval(self.newest).due = true;
        self.superseded = true;
    }

    /// Whether telemetry of the machine is due.
    #[inline]
    pub(super) const fn machine_due(&self) -> bool {
        self.machine.due
    }

    /// Whether any telemetry is due.
    #[inline]
    pub(super) const fn any_due(&self) -> bool {
        self.machine.due || self.haptic.due
    }
}

/// Samples the message of a stream; `None` without a haptic arm.
#[inline(never)]
pub(crate) fn sample(
    core: &Core,
    inputs: &Inputs,
    line: &LineCount,
    stream: Stream,
) -> Option<Report> {
    match stream {
        Stream::Machine => Some(Report::Telemetry(sample_machine(core, inputs, line))),
        Stream::Haptic => {
            let arm = core.machine.as_ref()?.masters.arm()?;
            Some(Report::Master(arm.telemetry(inputs.period)))
        }
    }
}

fn sample_machine(core: &Core, inputs: &Inputs, line: &LineCount) -> Telemetry {
    let mut sample = Telemetry {
        period: inputs.period,
        state: core.safety.state(),
        homed: core.safety.homed(),
        fault: core.safety.fault(),
        deferred_bytes: line.deferred_bytes,
        bad_frames: line.bad_frames,
        lost_bytes: line.lost_bytes,
        ..Telemetry::default()
    };
    if let Some(machine) = &core.machine {
        let program = &machine.motion.program;
        sample.credit = program.credit();
        sample.setpoint = program.reached();
        sample.program_periods = (program.program_time() >> 32) as u32;
        sample.speed_factor = (program.speed_factor() >> 17).clamp(0, 0xFFFF) as u16;
        machine.fill_telemetry(inputs, &mut sample);
        sample.force = machine.force.as_ref().map(ForceControl::telemetry);
        sample.io = machine.io_telemetry();
    }
    sample
}
