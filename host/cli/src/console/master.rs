//! The hand of a machine that has a haptic arm, or follows one: what is known here of its settings, and the keys that change them.
//!
//! A controller does not tell which reflection, walls and scale it has; it tells what they do. What is known here is therefore what this console set, and
//! what the machine file says if the controller took it from here. Otherwise another host may have set something else, and the value is marked as not sure. A wall
//! is found again by its push, which tells how deep the tip is in it.
//!
//! Forces N, places mm in the frame of the arm's base.
//!
//! Misuse: taking the place of a wall for where the controller has it to the last digit. [`Face::Approximate`] was put while the hand moved; and one of another host that nobody touches is not seen at all.

mod input;

use haptimill_machine_file::MachineFile;
use haptimill_machine_file::scale::{PER_EFFORT, PER_MM};
use haptimill_protocol::haptic::{COMPONENTS, ForceFeedback, MasterTelemetry};
use ratatui::crossterm::event::KeyCode;
use std::time::{Duration, Instant};

/// Names of the components.
pub(super) const NAMES: [&str; COMPONENTS] = ["x", "y", "z"];

/// Parts of a newton, and of a newton millimetre, in the report of a hand.
pub(super) const PER_REPORTED: f64 = 256.0;

/// G_P of 1.
const PER_SCALE: f64 = 4096.0;

/// A push below this tells nothing of a wall, N, and so near the most that a wall pushes it may be deeper.
const MIN_PUSH_N: f64 = 0.02;

/// The same wall, mm: the push is reported in steps.
const FACE_TOLERANCE_MM: f64 = 0.03;

/// A setting of which the controller does not tell.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Setting<T> {
    /// What the machine file says.
    file: T,
    /// What was asked for last.
    requested: T,
    /// What is in force.
    pub(super) active: T,
    /// No other host can have set something else.
    pub(super) known: bool,
}

impl<T: Copy + PartialEq> Setting<T> {
    const fn new(file: T) -> Self {
        Self {
            file,
            requested: file,
            active: file,
            known: false,
        }
    }

    /// The controller has it from the machine file.
    fn begin(&mut self) {
        self.acknowledge(self.file);
        self.requested = self.file;
    }

    fn acknowledge(&mut self, value: T) {
        self.active = value;
        self.known = true;
    }

    fn reject(&mut self, value: T) {
        if self.requested == value {
            self.requested = self.active;
        }
    }
}

/// A face of the box in which the hand is kept, as far as it is known here.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Face {
    /// Another host may have put one.
    Unknown,
    /// There is none.
    None,
    /// It was put about here, by a moving hand.
    Approximate(f64),
    /// It is here.
    FieldPosition(f64),
}

/// The haptic arm.
#[derive(Debug, Clone)]
pub(super) struct Arm {
    pub(super) feedback: Setting<ForceFeedback>,
    /// Of each axis the lower and the upper one.
    pub(super) faces: [[Face; 2]; COMPONENTS],
    /// Stiffness of the walls, N/mm, and the most that one pushes, N.
    stiffness: f64,
    max_push: f64,
    /// Period of the newest report, and when it came.
    last_period: Option<u64>,
    received_at: Instant,
    /// Reports to come from which no wall is learnt.
    stale_reports: u8,
}

/// What is known of the hand.
#[derive(Debug, Clone)]
pub(super) struct Master {
    /// The arm, if it is one of this machine.
    pub(super) arm: Option<Arm>,
    /// G_P, where the machine follows a hand.
    pub(super) scale: Option<Setting<u16>>,
}

/// What is changed by a key: a field of the overlay. Without an axis all of them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Field {
    Percent(Option<usize>),
    Limit(Option<usize>),
    Fixture { axis: Option<usize>, upper: bool },
    Scale,
}

/// Where a field is: rows x, y, z, all, G_P.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct FieldPosition {
    pub(super) row: usize,
    pub(super) column: usize,
}

/// The row of all axes, and the one of the scale.
pub(super) const ALL: usize = COMPONENTS;
pub(super) const SCALE: usize = COMPONENTS + 1;

/// Columns of a row of settings.
const COLUMNS: usize = 4;

impl FieldPosition {
    /// What is there.
    pub(super) fn field(self) -> Field {
        let axis = (self.row < ALL).then_some(self.row);
        match self.column {
            _ if self.row >= SCALE => Field::Scale,
            0 => Field::Percent(axis),
            1 => Field::Limit(axis),
            column => Field::Fixture {
                axis,
                upper: column > 2,
            },
        }
    }
}

impl Arm {
    /// A report, if it is a new one.
    fn handle_notice(&mut self, report: &MasterTelemetry) {
        if self.last_period.replace(report.period) == Some(report.period) {
            return;
        }
        self.received_at = Instant::now();
        if self.stale_reports > 0 {
            self.stale_reports -= 1;
            return;
        }
        for (axis, faces) in self.faces.iter_mut().enumerate() {
            let push = f64::from(report.fixture[axis]) / PER_REPORTED;
            if !(MIN_PUSH_N..self.max_push - MIN_PUSH_N).contains(&push.abs()) {
                continue;
            }
            let at = f64::from(report.pose.tip[axis]) / PER_MM + push / self.stiffness;
            let face = &mut faces[usize::from(push < 0.0)];
            if !matches!(face, Face::FieldPosition(before) if (*before - at).abs() < FACE_TOLERANCE_MM)
            {
                *face = Face::FieldPosition(at);
            }
        }
    }

    /// How old the newest report is.
    pub(super) fn age(&self) -> Duration {
        self.received_at.elapsed()
    }
}

impl Master {
    /// That of a machine; none when it has no haptic arm and follows none.
    pub(super) fn of(machine: &MachineFile) -> Option<Self> {
        let config = &machine.config;
        let arm = config.haptic.as_ref().map(|haptic| Arm {
            feedback: Setting::new(haptic.reflection),
            faces: [[Face::Unknown; 2]; COMPONENTS],
            stiffness: f64::from(haptic.wall.stiffness) / PER_EFFORT,
            max_push: f64::from(haptic.wall.most.0) / PER_EFFORT,
            last_period: None,
            received_at: Instant::now(),
            stale_reports: 0,
        });
        let scale = config
            .follow
            .as_ref()
            .map(|follow| Setting::new(follow.scale));
        (arm.is_some() || scale.is_some()).then_some(Self { arm, scale })
    }

    /// The controller took the machine file: no other host has set anything since.
    pub(super) fn begin(&mut self) {
        if let Some(arm) = &mut self.arm {
            arm.feedback.begin();
            arm.faces = [[Face::None; 2]; COMPONENTS];
        }
        if let Some(scale) = &mut self.scale {
            scale.begin();
        }
    }

    /// The link is gone, and every request with it.
    pub(super) fn handle_link_loss(&mut self) {
        if let Some(arm) = &mut self.arm {
            arm.feedback.requested = arm.feedback.active;
            arm.last_period = None;
        }
        if let Some(scale) = &mut self.scale {
            scale.requested = scale.active;
        }
    }

    /// The field in which the overlay begins.
    const fn first_position(&self) -> FieldPosition {
        let row = if self.arm.is_some() { 0 } else { SCALE };
        FieldPosition { row, column: 0 }
    }

    /// The field beside another one.
    fn neighbour(&self, at: FieldPosition, key: KeyCode) -> FieldPosition {
        let last = if self.scale.is_some() { SCALE } else { ALL };
        let FieldPosition { row, column } = at;
        match key {
            KeyCode::Up => FieldPosition {
                row: row.saturating_sub(1).max(self.first_position().row),
                column,
            },
            KeyCode::Down => FieldPosition {
                row: (row + 1).min(last),
                column,
            },
            KeyCode::Left => FieldPosition {
                row,
                column: column.saturating_sub(1),
            },
            _ => FieldPosition {
                row,
                column: (column + 1).min(COLUMNS - 1),
            },
        }
    }
}

/// A G_P as people write it.
pub(super) fn to_ratio(raw: u16) -> f64 {
    f64::from(raw) / PER_SCALE
}
