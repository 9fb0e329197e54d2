//! Models of the section `[kinematics]`, one module each: their keys and their reader.

mod cartesian;
mod corexy;
mod facet;
mod five_bar;
mod four_axis;
mod h4;
mod linear_delta;
mod polar_mill;
mod scara;
mod six_axis;
mod trunnion;

use super::document::Section;
use super::scale::{PER_MM, to_i32};
use haptimill_kinematics::descriptor::{AxisKind, Descriptor};
use haptimill_kinematics::{Machine, Model};
use haptimill_machine_keys::controller::kinematics::model;
use haptimill_machine_keys::{self as keys, Key};
use haptimill_math::Length;

/// Keys of a model in a machine file, and their reader.
pub(super) trait ModelFile {
    /// The machine.
    type Machine: Machine;

    /// Sections of the keys: those of `[kinematics]`, and those of `[plant.geometry.MODEL]`.
    const SECTIONS: [keys::Section; 2];

    /// The machine has a singularity, so `[supervision]` has `singularity_margin_mm`.
    const HAS_SINGULARITY: bool = false;

    /// Reads the keys of `[kinematics]`, and reports what they must not be together.
    /// `singularity_margin`, in mm, is a value of `[supervision]`.
    fn read(
        section: &Section<'_, '_>,
        singularity_margin: f64,
    ) -> <Self::Machine as Machine>::Geometry;
}

/// Defines the list of the models.
macro_rules! models {
    ($($name:ident($file:ty);)*) => {
        /// All models.
        const MODELS: &[ModelReader] = &[$(
            ModelReader {
                descriptor: &<<$file as ModelFile>::Machine as Machine>::DESCRIPTOR,
                sections: <$file>::SECTIONS,
                has_singularity: <$file>::HAS_SINGULARITY,
                read: |section, margin| Model::$name(<$file>::read(section, margin)),
            },
        )*];
    };
}

models! {
    H4(h4::File);
    Cartesian(cartesian::File);
    Trunnion(trunnion::File);
    Facet(facet::File);
    Scara(scara::File);
    FourAxis(four_axis::File);
    LinearDelta(linear_delta::File);
    FiveBar(five_bar::File);
    PolarMill(polar_mill::File);
    SixAxis(six_axis::File);
    Corexy(corexy::File);
}

/// A model and the reader of its keys.
#[derive(Debug, Clone, Copy)]
pub(super) struct ModelReader {
    /// Coordinates and joints.
    pub descriptor: &'static Descriptor,
    /// The keys.
    sections: [keys::Section; 2],
    /// The machine has a singularity, so `[supervision]` has `singularity_margin_mm`.
    pub has_singularity: bool,
    /// Reads the keys of the section; the second argument is the singularity margin in mm.
    read: fn(&Section<'_, '_>, f64) -> Model,
}

impl ModelReader {
    /// The model that the section names; `None` after a report.
    pub(super) fn of(section: &Section<'_, '_>) -> Option<Self> {
        let rows: Vec<_> = MODELS
            .iter()
            .map(|row| (row.descriptor.code, *row))
            .collect();
        section.choice(model, &rows)
    }

    /// Reads the section; `singularity_margin` is in mm.
    pub(super) fn read(&self, section: Section<'_, '_>, singularity_margin: f64) -> Model {
        let read = (self.read)(&section, singularity_margin);
        section.finish();
        read
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

/// Sections of the keys of all models: that of `[kinematics]` and that of `[plant.geometry.MODEL]`.
pub(super) fn sections() -> impl Iterator<Item = [keys::Section; 2]> {
    MODELS.iter().map(|row| row.sections)
}

/// Reads a length in mm.
fn length(section: &Section<'_, '_>, key: Key) -> Length {
    raw_length(section.value(key))
}

/// The controller's value of a length in mm.
fn raw_length(mm: f64) -> Length {
    Length(to_i32(mm * PER_MM))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every model of the controller can be in a machine file, and its keys are under its name.
    #[test]
    fn every_model_has_a_reader() {
        let codes = |descriptors: &[&Descriptor]| -> Vec<&str> {
            descriptors.iter().map(|it| it.code).collect()
        };
        let rows: Vec<&Descriptor> = MODELS.iter().map(|row| row.descriptor).collect();
        assert_eq!(codes(&rows), codes(haptimill_kinematics::DESCRIPTORS));
        for row in MODELS {
            let code = row.descriptor.code;
            let [kinematics, plant] = row.sections;
            assert_eq!(kinematics.path, "kinematics", "{code}");
            assert_eq!(plant.path, format!("plant.geometry.{code}"));
            assert_eq!([kinematics.model, plant.model], [Some(code); 2]);
        }
    }
}
