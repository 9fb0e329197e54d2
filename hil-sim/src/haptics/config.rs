//! Configuration of the haptic arm: the `[plant.haptic]` section of a machine file.

use super::geometry::HapticGeometry;
use super::motor::ActuatorConfig;
use super::sensors::HapticEncoders;
use crate::check::{Check, PlantError};
use serde::{Deserialize, Serialize};

/// Configuration of the haptic arm. All keys are optional; the defaults describe a desk-top arm of
/// the reference geometry with chosen masses and frictions.
///
/// ```
/// let text = r#"
/// start_mm = [0.0, 0.0, 0.0]
/// amplifier_lag_s = 0.0005
/// link_kg = 0.06
/// balance = 1.0
///
/// [geometry]                      # REF-M
/// base_radius_mm = 150.0          # r_b
/// link_mm = 200.0                 # L
/// platform_radius_mm = 50.0       # r_p
/// azimuth_deg = [0.0, 120.0, 240.0]  # theta1
/// tilt_deg = 30.0                 # theta2
/// home_mm = [0.0, 0.0, 450.0]
/// tip_mm = [0.0, 0.0, 150.0]
///
/// [handle]
/// mass_kg = 0.35
/// centre_mm = [0.0, 0.0, 40.0]
/// inertia_kg_mm2 = [600.0, 600.0, 250.0]
///
/// [slide]                         # kg, N, mm, s
/// inertia = 0.15
/// coulomb = 0.15
/// viscous = 0.001
/// full_scale = 20.0
/// limit = 15.0
///
/// [turn]                          # kg mm^2, N mm, rad, s
/// inertia = 150.0
/// coulomb = 10.0
/// viscous = 5.0
/// full_scale = 2000.0
/// limit = 1500.0
///
/// [encoders]
/// slide_counts_per_mm = 200.0
/// turn_counts_per_turn = 160000.0
/// hinge_counts_per_turn = 160000.0
/// "#;
/// let written: haptimill_hil_sim::haptics::HapticConfig = toml::from_str(text).unwrap();
/// assert_eq!(written, haptimill_hil_sim::haptics::HapticConfig::default());
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct HapticConfig {
    /// Lengths and angles.
    pub geometry: HapticGeometry,
    /// Platform and handle.
    pub handle: HandleConfig,
    /// Mass of each link, kg; half of it at each end.
    pub link_kg: f64,
    /// Drives of the slides: N, kg, mm.
    pub slide: ActuatorConfig,
    /// Drives of the turns: N mm, kg mm^2, rad.
    pub turn: ActuatorConfig,
    /// Time constant of the amplifiers' current, s.
    pub amplifier_lag_s: f64,
    /// Fraction of the weight that springs or counterweights balance: 1 all, 0 none.
    pub balance: f64,
    /// The nine encoders.
    pub encoders: HapticEncoders,
    /// End stops.
    pub stops: StopsConfig,
    /// Position of the handle at power on, from home, mm; the rail or a rest should hold it at 0.
    pub start_mm: [f64; 3],
}

/// Platform and handle as one rigid body, in the platform's frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HandleConfig {
    /// Mass, kg.
    pub mass_kg: f64,
    /// Centre of mass, from the platform's centre, mm.
    pub centre_mm: [f64; 3],
    /// Inertia about the centre of mass and the platform's axes, kg mm^2.
    pub inertia_kg_mm2: [f64; 3],
}

/// Stops that keep the arm from its singular poses.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StopsConfig {
    /// Ends of the slides' travel d, mm.
    pub slide_mm: [f64; 2],
    /// Ends of the hinges' angle theta4, degrees, between 1 and 89.
    pub hinge_deg: [f64; 2],
    /// Stiffness of a slide's stop, N/mm.
    pub slide_stiffness: f64,
    /// Stiffness of a hinge's stop, N mm/rad.
    pub hinge_stiffness: f64,
}

impl Default for HapticConfig {
    fn default() -> Self {
        Self {
            geometry: HapticGeometry::default(),
            handle: HandleConfig {
                mass_kg: 0.35,
                centre_mm: [0.0, 0.0, 40.0],
                inertia_kg_mm2: [600.0, 600.0, 250.0],
            },
            link_kg: 0.06,
            slide: ActuatorConfig {
                inertia: 0.15,
                coulomb: 0.15,
                viscous: 0.001,
                full_scale: 20.0,
                limit: 15.0,
            },
            turn: ActuatorConfig {
                inertia: 150.0,
                coulomb: 10.0,
                viscous: 5.0,
                full_scale: 2000.0,
                limit: 1500.0,
            },
            amplifier_lag_s: 0.0005,
            balance: 1.0,
            encoders: HapticEncoders::default(),
            stops: StopsConfig {
                slide_mm: [150.0, 450.0],
                hinge_deg: [8.0, 84.0],
                slide_stiffness: 20.0,
                hinge_stiffness: 2e5,
            },
            start_mm: [0.0; 3],
        }
    }
}

impl HapticConfig {
    /// Checks the whole configuration.
    ///
    /// # Errors
    /// All problems, not only the first.
    pub fn check(&self) -> Result<(), Vec<PlantError>> {
        let mut check = Check::default();
        self.geometry.check(&mut check);
        let field = |key: &str| format!("haptic: {key}");
        check.within(field("handle: mass_kg"), self.handle.mass_kg, 0.01, 100.0);
        for axis in 0..3 {
            let centre = self.handle.centre_mm[axis];
            check.within(
                field(&format!("handle: centre_mm {axis}")),
                centre,
                -1000.0,
                1000.0,
            );
            let inertia = self.handle.inertia_kg_mm2[axis];
            check.within(
                field(&format!("handle: inertia_kg_mm2 {axis}")),
                inertia,
                1.0,
                1e7,
            );
            let start = self.start_mm[axis];
            check.within(field(&format!("start_mm {axis}")), start, -500.0, 500.0);
        }
        check.within(field("link_kg"), self.link_kg, 0.0, 10.0);
        self.slide.check("slide", &mut check);
        self.turn.check("turn", &mut check);
        check.within(field("amplifier_lag_s"), self.amplifier_lag_s, 0.0, 1.0);
        check.within(field("balance"), self.balance, 0.0, 1.0);
        self.encoders.check(&mut check);
        let stops = &self.stops;
        let [low, high] = stops.slide_mm;
        check.within(field("stops: slide_mm: low"), low, -2000.0, 2000.0);
        check.within(field("stops: slide_mm: high"), high, low, 4000.0);
        let [low, high] = stops.hinge_deg;
        check.within(field("stops: hinge_deg: low"), low, 1.0, 89.0);
        check.within(field("stops: hinge_deg: high"), high, low, 89.0);
        // Springs are integrated explicitly: 10 N/mm on 10 g oscillates at 1000 rad/s, 0.05 of a
        // period in a substep of 50 us.
        check.within(
            field("stops: slide_stiffness"),
            stops.slide_stiffness,
            0.0,
            200.0,
        );
        check.within(
            field("stops: hinge_stiffness"),
            stops.hinge_stiffness,
            0.0,
            1e6,
        );
        check.done()
    }
}
