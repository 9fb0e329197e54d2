//! Settings of the haptic arm or of the position scale of a machine with a remote master, and the
//! fields that change them.
//!
//! A controller does not report its force feedback settings, virtual fixture and position scale,
//! only their effect. The values here are therefore those that this console set, or those of the
//! machine file if the controller took it from this console. Otherwise another host may have set
//! others, and the value is marked as unknown. A fixture face is recognised by its force, which
//! gives the depth of the tip in it.
//!
//! Forces in N, positions in mm in the base frame of the arm.
//!
//! The position of a fixture face is not exact: [`Face::Approximate`] was set while the master
//! moved. A face that another host set is unknown until the tip touches it.

use haptimill_machine_file::MachineFile;
use haptimill_machine_file::scale::{PER_EFFORT, PER_MM};
use haptimill_protocol::haptic::{COMPONENTS, ForceFeedback, MasterTelemetry};
use ratatui::crossterm::event::KeyCode;
use std::time::{Duration, Instant};

/// Units per N, and per N mm, in the master telemetry.
pub(super) const PER_REPORTED: f64 = 256.0;

/// Raw value of the position scale 1.
pub(super) const PER_SCALE: f64 = 4096.0;

/// Fixture forces below this, or this close to the largest fixture force, do not give the position
/// of the face, N.
const MIN_PUSH_N: f64 = 0.02;

/// Tolerance of face positions, mm: fixture forces are reported in steps.
pub(super) const FACE_TOLERANCE_MM: f64 = 0.03;

/// A setting that the controller does not report.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Setting<T> {
    /// Value in the machine file.
    file: T,
    /// Value requested last.
    pub(super) requested: T,
    /// Active value.
    pub(super) active: T,
    /// No other host can have changed it.
    pub(super) is_known: bool,
}

impl<T: Copy + PartialEq> Setting<T> {
    const fn new(file: T) -> Self {
        Self {
            file,
            requested: file,
            active: file,
            is_known: false,
        }
    }

    /// The controller took the machine file.
    fn begin(&mut self) {
        self.acknowledge(self.file);
        self.requested = self.file;
    }

    pub(super) fn acknowledge(&mut self, value: T) {
        self.active = value;
        self.is_known = true;
    }

    pub(super) fn reject(&mut self, value: T) {
        if self.requested == value {
            self.requested = self.active;
        }
    }
}

/// A face of the virtual fixture, as known here.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Face {
    /// Another host may have set one.
    Unknown,
    /// No face.
    None,
    /// Set near this position while the master moved, mm.
    Approximate(f64),
    /// Position, mm.
    Known(f64),
}

/// The haptic arm.
#[derive(Debug, Clone)]
pub(super) struct Arm {
    pub(super) feedback: Setting<ForceFeedback>,
    /// Lower and upper face along each axis.
    pub(super) faces: [[Face; 2]; COMPONENTS],
    /// Stiffness of the fixture, N/mm, and its largest force, N.
    stiffness: f64,
    max_push: f64,
    /// Control period of the newest report, and its time of arrival.
    last_period: Option<u64>,
    received_at: Instant,
    /// Number of next reports that may still describe the previous fixture.
    pub(super) stale_reports: u8,
}

/// Known settings of the master.
#[derive(Debug, Clone)]
pub(super) struct Master {
    /// The arm, if it belongs to this machine.
    pub(super) arm: Option<Arm>,
    /// Position scale, if a master drives the machine.
    pub(super) scale: Option<Setting<u16>>,
}

/// Field of the overlay. Without an axis it stands for all axes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Field {
    Percent(Option<usize>),
    Limit(Option<usize>),
    Fixture { axis: Option<usize>, upper: bool },
    Scale,
}

/// Row and column of a field; the rows are x, y, z, all, position scale.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct FieldPosition {
    pub(super) row: usize,
    pub(super) column: usize,
}

/// Row of all axes, and row of the position scale.
pub(super) const ALL: usize = COMPONENTS;
pub(super) const SCALE: usize = COMPONENTS + 1;

/// Columns of a row of settings.
const COLUMNS: usize = 4;

impl FieldPosition {
    /// The field at this position.
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
    /// Evaluates a report if it is new.
    pub(super) fn update(&mut self, report: &MasterTelemetry) {
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
            if !matches!(face, Face::Known(before) if (*before - at).abs() < FACE_TOLERANCE_MM) {
                *face = Face::Known(at);
            }
        }
    }

    /// Age of the newest report.
    pub(super) fn age(&self) -> Duration {
        self.received_at.elapsed()
    }
}

impl Master {
    /// Settings of a machine; none without a haptic arm and without a remote master.
    pub(super) fn from_machine(machine: &MachineFile) -> Option<Self> {
        let config = &machine.config;
        let arm = config.haptic.as_ref().map(|haptic| Arm {
            feedback: Setting::new(haptic.feedback),
            faces: [[Face::Unknown; 2]; COMPONENTS],
            stiffness: f64::from(haptic.fixture.stiffness) / PER_EFFORT,
            max_push: f64::from(haptic.fixture.max.0) / PER_EFFORT,
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

    /// Resets all values: the controller took the machine file, and no other host has set anything
    /// since.
    pub(super) fn begin(&mut self) {
        if let Some(arm) = &mut self.arm {
            arm.feedback.begin();
            arm.faces = [[Face::None; 2]; COMPONENTS];
        }
        if let Some(scale) = &mut self.scale {
            scale.begin();
        }
    }

    /// Discards all pending requests after a link loss.
    pub(super) fn handle_link_loss(&mut self) {
        if let Some(arm) = &mut self.arm {
            arm.feedback.requested = arm.feedback.active;
            arm.last_period = None;
        }
        if let Some(scale) = &mut self.scale {
            scale.requested = scale.active;
        }
    }

    /// The field selected first.
    pub(super) const fn first_position(&self) -> FieldPosition {
        let row = if self.arm.is_some() { 0 } else { SCALE };
        FieldPosition { row, column: 0 }
    }

    /// The neighbouring field in the direction of an arrow key.
    pub(super) fn neighbour(&self, at: FieldPosition, key: KeyCode) -> FieldPosition {
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

/// Position scale as a ratio.
pub(super) fn to_ratio(raw: u16) -> f64 {
    f64::from(raw) / PER_SCALE
}
