//! Grinding of a stone on a lap.
//!
//! The frame is that of the lap: the origin is its centre, z points away from it, and the stone is
//! the tool. The stone is a convex polyhedron in a frame of its own, whose origin is the tip of the
//! machine.
//!
//! # Method
//!
//! The lap is an elastic bed of E N/mm^3. The part of the stone that is d mm below its surface has
//! the pressure p = E d. Preston's law removes K p v mm of depth per second, where v is the speed
//! of the lap under the stone. Pressure and removal are linear in the place, so a ground facet
//! stays plane: its plane moves towards the surface of the lap with the rate K E v, in depth and in
//! direction. The solution over a control period is exact:
//!
//! ```text
//! N = E A d,   dh/dt = -K E v d,   d(n)/dt = K E v (n_lap - n)
//!
//! A area of the facet (mm^2), h its distance from the tip (mm), n its normal
//! ```
//!
//! The area is that of the section of the stone by the plane of the facet. When the stone leaves
//! the lap, the plane cuts the polyhedron.
//!
//! The lap may have a run-out, a wave of its surface once per turn below z = 0, and it may wear:
//! the removed volume lowers it where it was ground. The stone may have a hard spot, a ball in
//! which K is smaller; in a facet it stands proud by e:
//!
//! ```text
//! de/dt = K E v d - K_h E v (d + e),   e >= 0
//! ```
//!
//! # Limits
//!
//! * The pressure is the same over the lap; the stone does not float on its coolant.
//! * The speed of the lap is taken at the centre of the facet.
//! * The place of the hard spot in the facet does not count; a facet that is smaller than its
//!   section is hard as a whole.
//! * A stone that turns in contact by more than [`MAX_TURN`] begins a new facet.

use crate::check::{Check, PlantError};
use crate::polyhedron::{Plane, Polyhedron};
use crate::vector::{Vector, cross, dot, length, minus, plus, times};
use serde::{Deserialize, Serialize};

/// Turn of the stone in contact that begins a new facet, radians.
pub const MAX_TURN: f64 = 1e-3;

/// Radial cells of the wear of a lap.
const CELLS: usize = 64;

/// Change of depth after which the area of a facet is computed anew, mm.
const AREA_STEP: f64 = 5e-5;

/// A lap with its grit, for one material.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LapConfig {
    /// Preston's coefficient K, mm^2/N: depth per pressure and travel.
    pub preston_mm2_n: f64,
    /// Stiffness of the bed E, N/mm^3.
    pub bed_n_mm3: f64,
    /// Friction coefficient.
    pub friction: f64,
    /// Run-out of the surface, mm: from its lowest to its highest point.
    pub run_out_mm: f64,
    /// Volume that the lap loses for a volume of the stone.
    pub wear: f64,
    /// Radius, mm.
    pub radius_mm: f64,
}

impl Default for LapConfig {
    /// A lap of 75 mm radius with a grit that removes 50 um/s at 0.5 N/mm^2 and 2.5 m/s: chosen.
    fn default() -> Self {
        Self {
            preston_mm2_n: 4e-5,
            bed_n_mm3: 200.0,
            friction: 0.2,
            run_out_mm: 0.0,
            wear: 0.0,
            radius_mm: 75.0,
        }
    }
}

impl LapConfig {
    /// Checks the whole configuration.
    ///
    /// # Errors
    /// All problems.
    pub fn check(&self) -> Result<(), Vec<PlantError>> {
        let mut check = Check::default();
        for (name, value, low, high) in [
            ("preston_mm2_n", self.preston_mm2_n, 0.0, 1.0),
            ("bed_n_mm3", self.bed_n_mm3, 1.0, 1e5),
            ("friction", self.friction, 0.0, 1.0),
            ("run_out_mm", self.run_out_mm, 0.0, 1.0),
            ("wear", self.wear, 0.0, 1.0),
            ("radius_mm", self.radius_mm, 10.0, 500.0),
        ] {
            check.within(format!("lap: {name}"), value, low, high);
        }
        check.done()
    }
}

/// A ball in the stone that is harder.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HardSpot {
    /// Centre in the frame of the stone, mm.
    pub centre: Vector,
    /// Radius, mm.
    pub radius_mm: f64,
    /// Part of the removal of the rest, above 0 to 1.
    pub part: f64,
}

/// A facet that was ground.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ground {
    /// Plane in the frame of the stone.
    pub plane: Plane,
    /// Height of a hard spot above the plane, mm.
    pub proud_mm: f64,
    /// Force on the stone along the normal of the lap.
    pub force: ForceStatistics,
}

/// Force of a contact: means over whole turns of the lap.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct ForceStatistics {
    /// Largest force, N.
    pub peak_n: f64,
    /// Whole turns of the lap in contact.
    pub turns: u32,
    /// Mean of these turns, N.
    pub mean_n: f64,
    /// Least mean of a turn in the middle half of the contact, N.
    pub min_turn_n: f64,
    /// Largest mean of a turn in the middle half of the contact, N.
    pub max_turn_n: f64,
}

/// Means over a turn of the lap in contact.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Turn {
    /// Force on the stone along the normal of the lap, N.
    pub force_n: f64,
    /// Height of the tip above the lap, mm.
    pub height_mm: f64,
    /// Least and largest force of the turn, N.
    pub range_n: [f64; 2],
}

/// Largest number of turns of a contact whose means are kept.
const MAX_TURNS: usize = 4096;

/// Means over the turns of the lap, as they end.
#[derive(Debug, Clone, Default)]
struct Turns {
    peak: f64,
    sum: f64,
    heights: f64,
    range: [f64; 2],
    count: u32,
    done: f64,
    means: Vec<Turn>,
}

impl Turns {
    fn add(&mut self, force: f64, height: f64, turns: f64) {
        self.peak = self.peak.max(force);
        self.sum += force;
        self.heights += height;
        self.range = if self.count == 0 {
            [force; 2]
        } else {
            [self.range[0].min(force), self.range[1].max(force)]
        };
        self.count += 1;
        self.done += turns.abs();
        if self.done >= 1.0 {
            if self.means.len() < MAX_TURNS {
                let count = f64::from(self.count);
                self.means.push(Turn {
                    force_n: self.sum / count,
                    height_mm: self.heights / count,
                    range_n: self.range,
                });
            }
            (self.sum, self.heights, self.count) = (0.0, 0.0, 0);
            self.done -= 1.0;
        }
    }

    fn statistics(&self) -> ForceStatistics {
        let count = self.means.len();
        let forces =
            |turns: &'_ [Turn]| -> Vec<f64> { turns.iter().map(|turn| turn.force_n).collect() };
        let middle = forces(&self.means[count / 4..count - count / 4]);
        ForceStatistics {
            peak_n: self.peak,
            turns: count as u32,
            mean_n: forces(&self.means).iter().sum::<f64>() / count.max(1) as f64,
            min_turn_n: middle
                .iter()
                .copied()
                .fold(f64::INFINITY, f64::min)
                .min(self.peak),
            max_turn_n: middle.iter().copied().fold(0.0, f64::max),
        }
    }
}

/// The facet that is on the lap.
#[derive(Debug, Clone)]
struct Contact {
    plane: Plane,
    proud_mm: f64,
    /// Distance of the plane at which area and centre were computed.
    known_at: f64,
    area: f64,
    centre: Vector,
    turns: Turns,
}

/// Force on the stone in a period.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct GrindingForce {
    /// Force on the stone, N, lap frame.
    pub force: Vector,
    /// Its point, from the tip, mm, lap frame.
    pub from_tip: Vector,
}

/// A stone on a lap.
#[derive(Debug, Clone)]
pub struct Grinding {
    lap: LapConfig,
    /// Wear of the surface by radius, mm.
    wear: [f64; CELLS],
    /// Angle of the lap, turns.
    turns: f64,
    stone: Polyhedron,
    hard_spot: Option<HardSpot>,
    contact: Option<Contact>,
    ground: Vec<Ground>,
}

impl Grinding {
    /// A stone over a lap.
    ///
    /// # Errors
    /// All problems of the lap.
    pub fn new(lap: LapConfig, stone: Polyhedron) -> Result<Self, Vec<PlantError>> {
        lap.check()?;
        Ok(Self {
            lap,
            wear: [0.0; CELLS],
            turns: 0.0,
            stone,
            hard_spot: None,
            contact: None,
            ground: Vec::new(),
        })
    }

    /// Puts another lap on the spindle.
    ///
    /// # Errors
    /// All problems of the lap.
    pub fn set_lap(&mut self, lap: LapConfig) -> Result<(), Vec<PlantError>> {
        lap.check()?;
        self.lift_off();
        self.lap = lap;
        self.wear = [0.0; CELLS];
        Ok(())
    }

    /// Puts another stone, or the same one turned over, on the dop.
    pub fn set_stone(&mut self, stone: Polyhedron) {
        self.contact = None;
        self.stone = stone;
    }

    /// Sets or removes the hard spot, in the frame of the stone.
    pub const fn set_hard_spot(&mut self, spot: Option<HardSpot>) {
        self.hard_spot = spot;
    }

    /// The stone without the facet that is on the lap.
    #[must_use]
    pub const fn stone(&self) -> &Polyhedron {
        &self.stone
    }

    /// Facets in the order in which they left the lap; the tag of a face is its number here.
    #[must_use]
    pub fn ground(&self) -> &[Ground] {
        &self.ground
    }

    /// Wear of the lap by radius, mm, from the centre to the edge.
    #[must_use]
    pub const fn wear(&self) -> &[f64] {
        &self.wear
    }

    /// Area of the facet on the lap, mm^2; 0 in the air.
    #[must_use]
    pub fn contact_area(&self) -> f64 {
        self.contact.as_ref().map_or(0.0, |contact| contact.area)
    }

    /// Whole turns of the lap since the contact of the facet on the lap began.
    #[must_use]
    pub fn turns(&self) -> &[Turn] {
        self.contact
            .as_ref()
            .map_or(&[], |contact| &contact.turns.means)
    }

    /// Takes the stone off the lap: the plane of its facet cuts the polyhedron.
    pub fn lift_off(&mut self) {
        let Some(contact) = self.contact.take() else {
            return;
        };
        self.stone.cut(contact.plane, self.ground.len());
        self.ground.push(Ground {
            plane: contact.plane,
            proud_mm: contact.proud_mm,
            force: contact.turns.statistics(),
        });
    }

    /// Height of the lap's surface at a place, mm: 0 at its highest point, where a stone touches it
    /// first.
    fn surface(&self, at: Vector) -> f64 {
        let azimuth = libm::atan2(at[1], at[0]) / core::f64::consts::TAU;
        let wave = libm::cos(core::f64::consts::TAU * (self.turns - azimuth));
        0.5 * self.lap.run_out_mm * (wave - 1.0) - self.wear[self.cell(at)]
    }

    fn cell(&self, at: Vector) -> usize {
        let part = libm::hypot(at[0], at[1]) / self.lap.radius_mm;
        ((part * CELLS as f64) as usize).min(CELLS - 1)
    }

    /// Advances by one period: the tip and the directions of the stone's axes in the lap frame, and
    /// the turns of the lap in the period.
    pub fn step(&mut self, tip: Vector, axes: &[Vector; 3], turns: f64) -> GrindingForce {
        self.turns += turns;
        self.turns -= libm::floor(self.turns);
        // The lap in the frame of the stone: what is beyond this plane is below its surface.
        let normal = axes.map(|axis| -axis[2]);
        let to_lap = |v: Vector| {
            let [x, y, z] = [0, 1, 2].map(|i| times(axes[i], v[i]));
            plus(plus(x, y), z)
        };
        let on_lap = libm::hypot(tip[0], tip[1]) <= self.lap.radius_mm;
        let mut contact = match self.contact.take() {
            Some(contact) if length(minus(contact.plane.normal, normal)) < MAX_TURN => contact,
            Some(contact) => {
                self.contact = Some(contact);
                self.lift_off();
                return GrindingForce::default();
            }
            None => {
                let distance = self.stone.reach(normal);
                if !on_lap || distance <= tip[2] - self.surface(tip) {
                    return GrindingForce::default();
                }
                Contact {
                    plane: Plane { normal, distance },
                    proud_mm: 0.0,
                    known_at: f64::INFINITY,
                    area: 0.0,
                    centre: times(normal, distance),
                    turns: Turns::default(),
                }
            }
        };
        self.measure(&mut contact);
        let from_tip = to_lap(contact.centre);
        let centre = plus(tip, from_tip);
        let depth = dot(contact.centre, normal) - (tip[2] - self.surface(centre));
        let clear = depth + contact.proud_mm <= 0.0;
        if clear || !on_lap {
            // A run-out opens the contact once per turn; the facet ends when the stone is clear.
            contact.turns.add(0.0, tip[2], turns);
            let is_far = depth + contact.proud_mm < -(self.lap.run_out_mm + 2e-3);
            self.contact = Some(contact);
            if is_far || !on_lap {
                self.lift_off();
            }
            return GrindingForce::default();
        }
        let lap = self.lap;
        let radius = libm::hypot(centre[0], centre[1]);
        let travel = core::f64::consts::TAU * radius * turns;
        let goes = |preston: f64| 1.0 - libm::exp(-preston * lap.bed_n_mm3 * travel.abs());
        let hard = self
            .hard_spot
            .map_or(0.0, |spot| spot_area(&spot, &contact.plane));
        let hard = hard.min(contact.area);
        let soft_depth = depth.max(0.0);
        let hard_depth = (depth + contact.proud_mm).max(0.0);
        let push = lap.bed_n_mm3 * ((contact.area - hard) * soft_depth + hard * hard_depth);
        // The removal, and the turn of the plane about its centre. A facet that is smaller than the
        // spot is hard as a whole.
        let spot_part = self.hard_spot.map_or(1.0, |spot| spot.part);
        let is_hard = hard > 0.0 && hard >= contact.area;
        let part = goes(lap.preston_mm2_n * if is_hard { spot_part } else { 1.0 });
        let removed = part * soft_depth;
        if hard > 0.0 && !is_hard {
            let ground = goes(lap.preston_mm2_n * spot_part) * hard_depth;
            contact.proud_mm = (contact.proud_mm + removed - ground).max(0.0);
        }
        if soft_depth > 0.0 && part > 0.0 {
            let old = contact.plane.normal;
            let turned = plus(old, times(minus(normal, old), part));
            let turned = times(turned, 1.0 / length(turned));
            contact.plane = Plane {
                normal: turned,
                distance: dot(turned, contact.centre) - removed,
            };
            contact.centre = minus(contact.centre, times(turned, removed));
        }
        let volume = removed * contact.area;
        let friction = lap.friction * push;
        if lap.wear > 0.0 && volume > 0.0 {
            let cell = self.cell(centre);
            let width = lap.radius_mm / CELLS as f64;
            let ring = core::f64::consts::TAU * (cell as f64 + 0.5) * width * width;
            self.wear[cell] += lap.wear * volume / ring;
        }
        contact.turns.add(push, tip[2], turns);
        self.contact = Some(contact);
        // The lap drags the stone along.
        let way = cross([0.0, 0.0, 1.0], centre);
        let drag = if turns == 0.0 || radius == 0.0 {
            [0.0; 3]
        } else {
            times(way, friction * turns.signum() / radius)
        };
        GrindingForce {
            force: [drag[0], drag[1], push],
            from_tip,
        }
    }

    /// Area and centre of the facet.
    fn measure(&self, contact: &mut Contact) {
        if (contact.known_at - contact.plane.distance).abs() < AREA_STEP {
            return;
        }
        contact.known_at = contact.plane.distance;
        let corners = self.stone.section(&contact.plane);
        let Some(first) = corners.first() else {
            // The plane touches in a point, an edge or a face: the farthest vertex, and no area
            // until it has cut in.
            contact.known_at = f64::INFINITY;
            let normal = contact.plane.normal;
            let farthest = |at: &&Vector| dot(**at, normal);
            if let Some(vertex) = self
                .stone
                .vertices()
                .iter()
                .max_by(|a, b| farthest(a).total_cmp(&farthest(b)))
            {
                contact.centre = *vertex;
            }
            return;
        };
        let (mut area, mut sum) = (0.0, [0.0; 3]);
        for pair in corners.windows(2).skip(1) {
            let twice = dot(
                cross(minus(pair[0], *first), minus(pair[1], *first)),
                contact.plane.normal,
            );
            let third = times(plus(*first, plus(pair[0], pair[1])), 1.0 / 3.0);
            area += 0.5 * twice;
            sum = plus(sum, times(third, 0.5 * twice));
        }
        contact.area = area.max(0.0);
        contact.centre = if area > 1e-12 {
            times(sum, 1.0 / area)
        } else {
            *first
        };
    }
}

/// Area in which a plane cuts a ball.
fn spot_area(spot: &HardSpot, plane: &Plane) -> f64 {
    let away = plane.height(spot.centre);
    core::f64::consts::PI * (spot.radius_mm * spot.radius_mm - away * away).max(0.0)
}
