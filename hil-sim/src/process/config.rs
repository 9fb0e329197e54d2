//! Configuration of the cut: cutter, material, workpiece, spindle.
//!
//! Lengths in mm, angles in degrees, forces in N. All positions are in the frame of the table (x_w,
//! y_w, z_w); z points away from the table.

use crate::check::{Check, PlantError};
use core::fmt;
use serde::de::value::MapAccessDeserializer;
use serde::de::{Error, MapAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};

/// Cutting force coefficients of a material: the six coefficients of Altintas and Lee
/// (docs/control.md 5.1).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Coefficients {
    /// Tangential cutting coefficient K_tc, N/mm^2.
    pub tangential: f64,
    /// Radial cutting coefficient K_rc, N/mm^2.
    pub radial: f64,
    /// Axial cutting coefficient K_ac, N/mm^2, along the meridian of the ball, towards its tip.
    pub axial: f64,
    /// Tangential edge coefficient K_te, N/mm.
    pub tangential_edge: f64,
    /// Radial edge coefficient K_re, N/mm.
    pub radial_edge: f64,
    /// Axial edge coefficient K_ae, N/mm.
    pub axial_edge: f64,
}

impl Coefficients {
    /// Polyethylene with edge forces: plant P1 of docs/control.md 5.2.
    pub const P1: Self = Self {
        tangential: 60.5,
        radial: 82.6,
        axial: 32.1,
        tangential_edge: 0.118,
        radial_edge: 0.706,
        axial_edge: 0.014,
    };

    /// Polyethylene without edge forces: plant P2 of docs/control.md 5.2.
    pub const P2: Self = Self {
        tangential: 68.7,
        radial: 115.8,
        axial: 28.8,
        tangential_edge: 0.0,
        radial_edge: 0.0,
        axial_edge: 0.0,
    };
}

/// Parses a material: the name of a preset, or the six numbers.
fn material<'de, D: Deserializer<'de>>(from: D) -> Result<Coefficients, D::Error> {
    struct Material;
    impl<'de> Visitor<'de> for Material {
        type Value = Coefficients;

        fn expecting(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
            out.write_str("\"P1\", \"P2\" or the six coefficients")
        }

        fn visit_str<E: Error>(self, name: &str) -> Result<Coefficients, E> {
            match name {
                "P1" => Ok(Coefficients::P1),
                "P2" => Ok(Coefficients::P2),
                other => Err(E::unknown_variant(other, &["P1", "P2"])),
            }
        }

        fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Coefficients, A::Error> {
            Coefficients::deserialize(MapAccessDeserializer::new(map))
        }
    }
    from.deserialize_any(Material)
}

/// A ball-end mill, and the contact of the part of it that does not cut.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CutterConfig {
    /// Radius R_0 of the ball and of the shank, mm. 0.5 to 25.
    pub radius_mm: f64,
    /// Helix angle i_0 at the transition from ball to shank, degrees; 0 is a straight flute. 0 to
    /// 60.
    pub helix_deg: f64,
    /// Number of teeth N_f, evenly spaced. 1 to 8.
    pub teeth: usize,
    /// Height of the flutes above the tip, mm; at least the radius.
    pub flute_length_mm: f64,
    /// Slices of the ball from tip to equator, of equal angle; the slices of the shank are equally
    /// fine. 4 to 128.
    pub slices: usize,
    /// Material; in a machine file `material`, by the name of a preset ("P1", "P2") or the six
    /// numbers.
    #[serde(rename = "material", deserialize_with = "material")]
    pub coefficients: Coefficients,
    /// Factor on all forces of the cut.
    pub force_scale: f64,
    /// Chip thickness at which the edge force reaches its full size, mm; it rises linearly from
    /// zero. Without this onset, rounding errors of the position of a stationary tool would switch
    /// the edge force on and off.
    pub edge_onset_mm: f64,
    /// Distance of the cutter's body behind its edges, mm. When the material reaches deeper than
    /// this between two teeth, the body presses on it: the spindle stands still while the tool is
    /// fed, or the feed is far too fast.
    pub relief_mm: f64,
    /// Pressure of the body on the material per mm of depth, N/mm^3.
    pub body_stiffness: f64,
    /// Yield pressure of the material, N/mm^2.
    pub body_pressure: f64,
}

impl Default for CutterConfig {
    /// The mill of the experiments: 8 mm ball, 2 flutes. Helix 30 degrees and coefficients P1 are
    /// estimates of docs/control.md 5.2. Relief and body are estimates for polyethylene (modulus
    /// some 800 N/mm^2, strained over about two radii of the ball; hardness 60 N/mm^2).
    fn default() -> Self {
        Self {
            radius_mm: 4.0,
            helix_deg: 30.0,
            teeth: 2,
            flute_length_mm: 16.0,
            slices: 32,
            coefficients: Coefficients::P1,
            force_scale: 1.0,
            edge_onset_mm: 0.0002,
            relief_mm: 0.15,
            body_stiffness: 100.0,
            body_pressure: 60.0,
        }
    }
}

/// A rectangle in x and y of the table's frame, mm.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Area {
    /// Lower end in x.
    pub x_min: f64,
    /// Upper end in x.
    pub x_max: f64,
    /// Lower end in y.
    pub y_min: f64,
    /// Upper end in y.
    pub y_max: f64,
}

impl Area {
    /// Returns whether the area contains a point.
    #[inline]
    pub fn contains(&self, x: f64, y: f64) -> bool {
        x >= self.x_min && x <= self.x_max && y >= self.y_min && y <= self.y_max
    }
}

/// A block of material with a plane top.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct WorkpieceConfig {
    /// Area of the material.
    pub stock: Area,
    /// Area in which the cut surface is recorded. Outside of it the stock always counts as uncut;
    /// see [`crate::process::Workpiece::missed`].
    pub map: Area,
    /// Grid spacing of the map, mm. 0.01 to 1.
    pub cell_mm: f64,
    /// Height of the top at x = y = 0, mm.
    pub top_mm: f64,
    /// Angle by which the top rises towards +x, degrees; negative towards -x.
    pub rise_x_deg: f64,
    /// Angle by which the top rises towards +y, degrees.
    pub rise_y_deg: f64,
    /// Height of the underside, mm; there is no material below it.
    pub bottom_mm: f64,
}

impl Default for WorkpieceConfig {
    /// A flat block of 140 x 120 x 30 mm with its top at height 0. The map covers the slot, the
    /// pocket and the circle of the experiments.
    fn default() -> Self {
        Self {
            stock: Area {
                x_min: -90.0,
                x_max: 50.0,
                y_min: -60.0,
                y_max: 60.0,
            },
            map: Area {
                x_min: -60.0,
                x_max: 8.0,
                y_min: -22.0,
                y_max: 22.0,
            },
            cell_mm: 0.05,
            top_mm: 0.0,
            rise_x_deg: 0.0,
            rise_y_deg: 0.0,
            bottom_mm: -30.0,
        }
    }
}

/// Spindle with a first-order lag of its speed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SpindleConfig {
    /// Time constant of the speed, seconds; 0 is immediate.
    pub time_constant_s: f64,
}

impl Default for SpindleConfig {
    fn default() -> Self {
        Self {
            time_constant_s: 0.3,
        }
    }
}

/// Configuration of [`crate::process::Cutting`].
#[derive(Debug, Clone, Default, PartialEq)]
pub struct CuttingConfig {
    /// The cutter.
    pub cutter: CutterConfig,
    /// The workpiece.
    pub workpiece: WorkpieceConfig,
}

impl CuttingConfig {
    /// Checks the whole configuration.
    ///
    /// # Errors
    /// All problems.
    pub fn check(&self) -> Result<(), Vec<PlantError>> {
        let mut check = Check::default();
        self.cutter.check(&mut check);
        self.workpiece.check(&mut check);
        check.done()
    }
}

impl CutterConfig {
    /// All problems of the cutter alone.
    pub(crate) fn problems(&self) -> Vec<PlantError> {
        let mut check = Check::default();
        self.check(&mut check);
        check.done().err().unwrap_or_default()
    }

    fn check(&self, check: &mut Check) {
        check.within("cutter: radius_mm".into(), self.radius_mm, 0.05, 25.0);
        check.within("cutter: helix_deg".into(), self.helix_deg, 0.0, 60.0);
        check.within("cutter: teeth".into(), self.teeth as f64, 1.0, 8.0);
        check.within(
            "cutter: flute_length_mm".into(),
            self.flute_length_mm,
            self.radius_mm,
            200.0,
        );
        check.within("cutter: slices".into(), self.slices as f64, 4.0, 128.0);
        check.within("cutter: force_scale".into(), self.force_scale, 0.0, 1e3);
        check.within("cutter: edge_onset_mm".into(), self.edge_onset_mm, 0.0, 0.1);
        check.within("cutter: relief_mm".into(), self.relief_mm, 0.01, 5.0);
        check.within(
            "cutter: body_stiffness".into(),
            self.body_stiffness,
            0.0,
            1e6,
        );
        check.within("cutter: body_pressure".into(), self.body_pressure, 0.0, 1e5);
        let material = &self.coefficients;
        for (name, value) in [
            ("tangential", material.tangential),
            ("radial", material.radial),
            ("axial", material.axial),
            ("tangential_edge", material.tangential_edge),
            ("radial_edge", material.radial_edge),
            ("axial_edge", material.axial_edge),
        ] {
            check.within(format!("cutter: material: {name}"), value, -1e5, 1e5);
        }
    }
}

impl WorkpieceConfig {
    fn check(&self, check: &mut Check) {
        check.within("workpiece: cell_mm".into(), self.cell_mm, 0.01, 1.0);
        for (name, area) in [("stock", &self.stock), ("map", &self.map)] {
            for (field, low, high) in [
                ("x_max", area.x_min, area.x_max),
                ("y_max", area.y_min, area.y_max),
            ] {
                check.within(
                    format!("workpiece: {name}: {field}"),
                    high,
                    low + 1.0,
                    2000.0,
                );
                check.within(
                    format!("workpiece: {name}: lower end of {field}"),
                    low,
                    -2000.0,
                    2000.0,
                );
            }
        }
        let points = (self.map.x_max - self.map.x_min) * (self.map.y_max - self.map.y_min)
            / (self.cell_mm * self.cell_mm);
        check.within("workpiece: points of the map".into(), points, 1.0, 5e7);
        check.within("workpiece: top_mm".into(), self.top_mm, -2000.0, 2000.0);
        check.within(
            "workpiece: bottom_mm".into(),
            self.bottom_mm,
            -4000.0,
            2000.0,
        );
        if self.bottom_mm >= self.top_mm {
            let problem = format!(
                "{} is not below top_mm = {}; lower it",
                self.bottom_mm, self.top_mm
            );
            check.refuse("workpiece: bottom_mm".into(), problem);
        }
        check.within("workpiece: rise_x_deg".into(), self.rise_x_deg, -60.0, 60.0);
        check.within("workpiece: rise_y_deg".into(), self.rise_y_deg, -60.0, 60.0);
    }
}

impl SpindleConfig {
    /// Checks the whole configuration.
    ///
    /// # Errors
    /// All problems.
    pub fn check(&self) -> Result<(), Vec<PlantError>> {
        let mut check = Check::default();
        check.within(
            "spindle: time_constant_s".into(),
            self.time_constant_s,
            0.0,
            60.0,
        );
        check.done()
    }
}
