//! Models of the section `[kinematics]`, one row each.

use super::document::Section;
use super::{h4, trunnion};
use haptimill_kinematics::cartesian::{Cartesian, CartesianGeometry};
use haptimill_kinematics::descriptor::{AxisKind, Descriptor};
use haptimill_kinematics::h4::H4;
use haptimill_kinematics::trunnion::Trunnion;
use haptimill_kinematics::{Machine, Model};
use haptimill_machine_keys::controller::kinematics::model;

/// A model and the reader of its keys.
#[derive(Debug, Clone, Copy)]
pub(super) struct ModelReader {
    /// Coordinates and joints.
    pub descriptor: &'static Descriptor,
    /// The machine has a singularity, so `[supervision]` has `singularity_margin_mm`.
    pub has_singularity: bool,
    /// Reads the keys of the section; the second argument is the singularity margin in mm.
    pub read: fn(Section<'_, '_>, f64) -> Model,
}

/// All models.
const MODELS: [ModelReader; 3] = [
    ModelReader {
        descriptor: &H4::DESCRIPTOR,
        has_singularity: true,
        read: |section, margin| Model::H4(h4::read_geometry(section, margin)),
    },
    ModelReader {
        descriptor: &Cartesian::DESCRIPTOR,
        has_singularity: false,
        read: |section, _| {
            section.finish();
            Model::Cartesian(CartesianGeometry {})
        },
    },
    ModelReader {
        descriptor: &Trunnion::DESCRIPTOR,
        has_singularity: false,
        read: |section, _| Model::Trunnion(trunnion::read_geometry(section)),
    },
];

impl ModelReader {
    /// The model that the section names; `None` after a report.
    pub(super) fn of(section: &Section<'_, '_>) -> Option<Self> {
        section.choice(model, &MODELS.map(|row| (row.descriptor.code, row)))
    }

    /// Names and kinds of the pose coordinates.
    pub(super) fn pose(&self) -> Vec<(&'static str, AxisKind)> {
        let pose = self.descriptor.pose.iter();
        pose.map(|axis| (axis.name, axis.kind)).collect()
    }

    /// Names and kinds of the joints.
    pub(super) fn joints(&self) -> Vec<(&'static str, AxisKind)> {
        let joints = self.descriptor.joints.iter();
        joints.map(|joint| (joint.name, joint.kind)).collect()
    }
}
