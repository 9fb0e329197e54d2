//! The job that cuts a gem: stages, laps, and for each facet a part program.
//!
//! All facets of a side are ground on one lap, then on the next finer one, which takes off the
//! stock that the one before left. Between two facets the stone retracts to a height at which
//! nothing of it can touch the lap, whatever its angle; there it spins, tilts, and moves to the
//! place on the lap. It approaches in z alone, so no other facet comes near the lap before its own
//! does.

mod mount;
mod program;

pub use mount::Mount;

use crate::design::{Side, Stage};
use crate::gem::Gem;
use crate::problem::one_line;
use core::fmt::Write as _;
use haptimill_hil_sim::polyhedron::{Plane, Polyhedron, area_vector};
use haptimill_hil_sim::vector::{Vector, dot, length, minus, times};
use mount::{IndexWords, RADIAN};
use program::plain;
use serde::{Deserialize, Deserializer};

/// Reads a name into one line.
fn name<'de, D: Deserializer<'de>>(from: D) -> Result<String, D::Error> {
    String::deserialize(from).map(|name| one_line(&name))
}

/// A lap of the job.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Lap {
    /// Name: its grit.
    #[serde(deserialize_with = "name")]
    pub name: String,
    /// Speed, rev/min; negative counter-clockwise.
    pub rpm: f64,
    /// Depth that it leaves for the next lap, mm.
    pub stock_mm: f64,
    /// Feed into the stone, mm/s; by feed less where a facet is so large that its force would
    /// exceed [`JobSettings::max_force_n`].
    pub feed_mm_s: f64,
    /// Force of the stone on the lap under force control, N. A facet on which it would remove more
    /// than the maximum feed gets the force that removes as much.
    pub force_n: f64,
    /// Time at the final depth in which the stone sparks out, s.
    pub spark_out_s: f64,
    /// Preston's coefficient, mm^2/N: that of the simulated lap, and that from which the feed by
    /// force is planned.
    pub preston_mm2_n: f64,
}

/// How facets are ground.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Mode {
    /// By feed to the depth, with a steady force of at most [`JobSettings::max_force_n`].
    #[default]
    Feed,
    /// By force: the stone is lowered a little faster than its force removes material, at most at
    /// 0.15 mm/s. A force above its setpoint displaces the stone. The facet ends at the depth.
    Force,
    /// By the feed of the lap. A force above its setpoint displaces the stone.
    Both,
}

impl Mode {
    /// Whether the force is controlled.
    #[must_use]
    pub const fn has_force(self) -> bool {
        matches!(self, Self::Force | Self::Both)
    }
}

/// Coolant of a machine that a part program switches.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Coolant {
    /// None: the cutter wets the lap.
    None,
    /// Mist, M7.
    Mist,
    /// Flood, M8.
    Flood,
}

/// Maximum speed at which the stone is lowered by force, mm/s.
const FORCE_FEED: f64 = 0.15;

/// Ratio of the feed by force to the removal at the force setpoint. Above 1, so that the stone
/// is displaced and the force loop is closed. The rest of the feed raises the force by K_V times
/// it.
const LEAD: f64 = 1.1;

/// Smallest force setpoint, N: below, noise and friction are a large part of it.
const MIN_FORCE_N: f64 = 0.5;

/// Default of [`JobSettings::max_force_n`], N.
pub const MAX_FORCE_N: f64 = 15.0;

/// Largest number of strokes of a facet.
const MAX_STROKES: usize = 20_000;

/// Settings of a job.
#[derive(Debug, Clone, PartialEq)]
pub struct JobSettings {
    /// Laps from coarse to fine.
    pub laps: Vec<Lap>,
    /// How facets are ground.
    pub mode: Mode,
    /// Largest steady force of a facet by feed, N, as Preston's law has it: the feed of a large
    /// facet is limited to what this force removes.
    pub max_force_n: f64,
    /// Distance of the stone from the centre of the lap, mm.
    pub radius_mm: f64,
    /// Width of the sweep over the lap, mm.
    pub sweep_mm: f64,
    /// Speed of the sweep, mm/s.
    pub sweep_mm_s: f64,
    /// Distance of the stone from the lap at the retracted height, mm.
    pub clearance_mm: f64,
    /// The index of the machine wraps around, see [`crate::index_wraps`].
    pub index_wraps: bool,
}

impl Default for JobSettings {
    /// Three laps for quartz. The coefficients are chosen.
    fn default() -> Self {
        let lap = |name: &str, stock, feed, force, spark_out, preston| Lap {
            name: name.to_string(),
            rpm: 600.0,
            stock_mm: stock,
            feed_mm_s: feed,
            force_n: force,
            spark_out_s: spark_out,
            preston_mm2_n: preston,
        };
        Self {
            laps: vec![
                lap("260", 0.05, 0.08, 4.0, 0.5, 4e-5),
                lap("1200", 0.006, 0.02, 3.0, 2.0, 8e-6),
                lap("polish", 0.0, 0.004, 2.0, 5.0, 4e-6),
            ],
            mode: Mode::Feed,
            max_force_n: MAX_FORCE_N,
            radius_mm: 45.0,
            sweep_mm: 10.0,
            sweep_mm_s: 20.0,
            clearance_mm: 2.0,
            index_wraps: false,
        }
    }
}

impl JobSettings {
    /// Problems of the settings, with the remedy.
    #[must_use]
    pub fn problem(&self) -> Option<String> {
        let Some(last) = self.laps.last() else {
            return Some("the job has no lap; add one".to_string());
        };
        for lap in &self.laps {
            for (key, value, low, high) in [
                ("rpm", lap.rpm.abs(), 1.0, 32_767.0),
                ("stock_mm", lap.stock_mm, 0.0, 5.0),
                ("feed_mm_s", lap.feed_mm_s, 1e-4, 5.0),
                ("force_n", lap.force_n, 0.5, 100.0),
                ("spark_out_s", lap.spark_out_s, 0.0, 120.0),
                ("preston_mm2_n", lap.preston_mm2_n, 1e-9, 1.0),
            ] {
                if !(low..=high).contains(&value) {
                    let name = &lap.name;
                    return Some(format!(
                        "lap {name}: {key} is {value}; write {low} to {high}"
                    ));
                }
            }
        }
        let falls = |pair: &[Lap]| pair[1].stock_mm < pair[0].stock_mm;
        if let Some(pair) = self.laps.windows(2).find(|pair| !falls(pair)) {
            let (before, name) = (&pair[0].name, &pair[1].name);
            return Some(format!(
                "lap {name} leaves as much stock as lap {before} before it; lower its stock_mm"
            ));
        }
        (last.stock_mm != 0.0).then(|| {
            let name = &last.name;
            format!("lap {name} is the last one and leaves stock; write stock_mm = 0")
        })
    }
}

/// A facet on a lap.
#[derive(Debug, Clone, PartialEq)]
pub struct Operation {
    /// Number of the facet.
    pub facet: usize,
    /// Number of the lap.
    pub lap: usize,
    /// Stage.
    pub stage: Stage,
    /// Force setpoint under force control, N: that of the lap, or less on a small facet.
    pub force_n: f64,
    /// Part program from the retracted height to the end of the facet.
    pub grind: String,
    /// Part program of more sweeps at the depth.
    pub sweep: String,
    /// Part program back to the retracted height.
    pub retract: String,
    /// Height of the tip at the end of the facet, mm.
    pub depth_mm: f64,
    /// Area on the lap at the end of the facet, mm^2: before its neighbours are cut.
    pub area_mm2: f64,
    /// Largest distance of its corners from the axis of the tip on the lap then, mm.
    pub extent_mm: f64,
}

/// Facets that are ground on one lap from one side.
#[derive(Debug, Clone, PartialEq)]
pub struct Pass {
    /// How the stone sits on the dop.
    pub mount: Mount,
    /// Number of the lap.
    pub lap: usize,
    /// Facets in their order.
    pub operations: Vec<Operation>,
}

/// A job.
#[derive(Debug, Clone, PartialEq)]
pub struct Job {
    /// Settings.
    pub settings: JobSettings,
    /// Passes in their order.
    pub passes: Vec<Pass>,
    /// Height at which the stone is clear of the lap, mm.
    pub retracted_mm: f64,
}

impl Job {
    /// Plans the job of a gem.
    ///
    /// # Errors
    /// A problem of the settings, with its remedy.
    pub fn new(gem: &Gem, settings: JobSettings) -> Result<Self, String> {
        if let Some(problem) = settings.problem() {
            return Err(problem);
        }
        let mut stone = gem.rough_body();
        let reach = stone.vertices().iter().map(|at| length(*at));
        let retracted_mm = reach.fold(0.0, f64::max) + settings.clearance_mm;
        let mut passes = Vec::new();
        let mut words = IndexWords {
            wraps: settings.index_wraps,
            at: 0.0,
        };
        let mut sides: Vec<Side> = Vec::new();
        for facet in &gem.design.facets {
            if !sides.contains(&facet.side) {
                sides.push(facet.side);
            }
        }
        for side in sides {
            let mount = Mount { side };
            for (number, lap) in settings.laps.iter().enumerate() {
                let mut operations = Vec::new();
                for (facet, of) in gem.design.facets.iter().enumerate() {
                    // A preform is shaped on the first lap only.
                    let is_over = of.stage == Stage::Preform && number > 0;
                    if of.side != side || is_over {
                        continue;
                    }
                    let stock = if of.stage == Stage::Preform {
                        0.0
                    } else {
                        lap.stock_mm
                    };
                    let plane = gem.plane(facet);
                    let goal = Plane {
                        distance: plane.distance + stock,
                        ..plane
                    };
                    let above = stone.reach(goal.normal);
                    if above <= goal.distance {
                        continue;
                    }
                    let at = Place {
                        settings: &settings,
                        lap,
                        force_n: force_n(&settings, lap, &stone, &goal),
                        retracted: retracted_mm,
                        start: above + APPROACH_MM,
                        goal: goal.distance,
                    };
                    let contact = stone.section(&goal);
                    let area_mm2 = area_mm2(&contact, &goal);
                    let Some(depths) = at.strokes(&stone, goal) else {
                        return Err(format!(
                            "{} of {area_mm2:.1} mm^2 takes more than {MAX_STROKES} strokes on lap \
                             {}; raise feed_mm_s, force_n or preston_mm2_n of the lap, lower the \
                             stock before it, or cut a smaller stone",
                            gem.place(facet),
                            lap.name
                        ));
                    };
                    stone.cut(goal, facet);
                    let [angle, index] = mount.pose(goal.normal, settings.index_wraps);
                    let index = words.word(index);
                    operations.push(Operation {
                        facet,
                        lap: number,
                        stage: of.stage,
                        depth_mm: goal.distance,
                        area_mm2,
                        extent_mm: extent_mm(&contact, &goal),
                        force_n: at.force_n,
                        grind: at.grind(&of.name, angle, &index, &depths),
                        sweep: at.sweep(),
                        retract: at.retract(),
                    });
                }
                if !operations.is_empty() {
                    passes.push(Pass {
                        mount,
                        lap: number,
                        operations,
                    });
                }
            }
        }
        Ok(Self {
            settings,
            passes,
            retracted_mm,
        })
    }

    /// Part program to where the stone spins and tilts, at the inner end of the sweep.
    #[must_use]
    pub fn above(&self) -> String {
        let inner = self.settings.radius_mm - 0.5 * self.settings.sweep_mm;
        format!("G21 G90\nG0 Z{:.4}\nG0 X{inner:.4} Y0", self.retracted_mm)
    }

    /// The rough as it sits on the dop for a mount, in the frame of the tip.
    #[must_use]
    pub fn mounted(stone: &Polyhedron, mount: &Mount) -> Polyhedron {
        stone.moved(&mount.axes(), [0.0; 3])
    }
}

/// Distance of the stone from the lap at which the feed begins, mm.
const APPROACH_MM: f64 = 0.05;

/// Area of a section in its plane, mm^2.
fn area_mm2(section: &[Vector], plane: &Plane) -> f64 {
    0.5 * dot(area_vector(section), plane.normal)
}

/// Largest distance of the corners of a section from the foot of the origin in its plane, mm.
fn extent_mm(section: &[Vector], plane: &Plane) -> f64 {
    let foot = times(plane.normal, plane.distance);
    let distances = section.iter().map(|at| length(minus(*at, foot)));
    distances.fold(0.0, f64::max)
}

/// Depth that a newton removes by Preston's law where the plane of a facet is `plane`, K v / A,
/// mm/s.
fn removal_mm_s(settings: &JobSettings, lap: &Lap, stone: &Polyhedron, plane: &Plane) -> f64 {
    let area = area_mm2(&stone.section(plane), plane);
    let speed = core::f64::consts::TAU * settings.radius_mm * lap.rpm.abs() / 60.0;
    lap.preston_mm2_n * speed / area.max(1e-9)
}

/// Force setpoint of a facet: that of the lap, or what removes as much as the maximum feed.
fn force_n(settings: &JobSettings, lap: &Lap, stone: &Polyhedron, goal: &Plane) -> f64 {
    let max = FORCE_FEED / LEAD / removal_mm_s(settings, lap, stone, goal);
    lap.force_n.min(max.max(MIN_FORCE_N))
}

/// Heights of the tip for a facet on a lap, mm.
struct Place<'a> {
    settings: &'a JobSettings,
    lap: &'a Lap,
    /// Force setpoint, N.
    force_n: f64,
    retracted: f64,
    /// Where the feed begins.
    start: f64,
    /// Where the facet is done.
    goal: f64,
}

impl Place<'_> {
    /// Inner and outer end of the sweep.
    fn ends(&self) -> [f64; 2] {
        let half = 0.5 * self.settings.sweep_mm;
        [
            self.settings.radius_mm - half,
            self.settings.radius_mm + half,
        ]
    }

    /// Feed of the sweep, mm/min.
    fn feed(&self) -> f64 {
        60.0 * self.settings.sweep_mm_s
    }

    /// Depth that the force setpoint removes where the plane of the facet is `plane`, mm/s.
    fn removal_mm_s(&self, stone: &Polyhedron, plane: &Plane) -> f64 {
        removal_mm_s(self.settings, self.lap, stone, plane) * self.force_n
    }

    /// Heights at the ends of the strokes; `None` if there are too many. In the strokes at the
    /// depth the displaced stone reaches the depth and sparks out.
    fn strokes(&self, stone: &Polyhedron, goal: Plane) -> Option<Vec<f64>> {
        let mode = self.settings.mode;
        let stroke_s = self.settings.sweep_mm / self.settings.sweep_mm_s;
        let mut depths = Vec::new();
        let (mut distance, mut behind) = (self.start, 0.0);
        while distance > self.goal {
            if depths.len() > MAX_STROKES {
                return None;
            }
            let removal = self.removal_mm_s(stone, &Plane { distance, ..goal });
            let feed = match mode {
                Mode::Force => (LEAD * removal).min(FORCE_FEED),
                Mode::Both => self.lap.feed_mm_s,
                Mode::Feed => {
                    // The area at the end of the stroke is the largest one.
                    let feed = self.lap.feed_mm_s;
                    let distance = (distance - stroke_s * feed).max(self.goal);
                    let end = Plane { distance, ..goal };
                    let per_newton = removal_mm_s(self.settings, self.lap, stone, &end);
                    feed.min(self.settings.max_force_n * per_newton)
                }
            };
            let next = (distance - stroke_s * feed).max(self.goal);
            if mode.has_force() {
                behind = f64::max(behind + (distance - next) - stroke_s * removal, 0.0);
            }
            distance = next;
            depths.push(distance);
        }
        let left_s = behind / self.removal_mm_s(stone, &goal) + self.lap.spark_out_s;
        let left = libm::ceil(left_s / stroke_s);
        if left > MAX_STROKES as f64 {
            return None;
        }
        // The last stroke ends where the first one began.
        let left = left as usize + (depths.len() + left as usize) % 2;
        depths.extend(core::iter::repeat_n(self.goal, left));
        Some(depths)
    }

    /// `index` is the word of the index.
    fn grind(&self, name: &str, angle: f64, index: &str, depths: &[f64]) -> String {
        let (name, lap) = (plain(name), plain(&self.lap.name));
        let [inner, outer] = self.ends();
        let Self {
            retracted, start, ..
        } = self;
        let mut text = format!("(facet {name}, lap {lap})\n");
        let _ = writeln!(text, "G21 G90 G94");
        let _ = writeln!(text, "G0 Z{retracted:.4}");
        let _ = writeln!(text, "{}", self.spindle());
        let _ = writeln!(text, "G0 {index}");
        let _ = writeln!(text, "G0 A{angle:.6}");
        let _ = writeln!(text, "G0 X{inner:.4} Y0");
        let _ = writeln!(text, "G0 Z{start:.5}");
        // The path is nearly that of the sweep, and so is its feed.
        let feed = self.feed();
        for (stroke, z) in depths.iter().enumerate() {
            let x = if stroke % 2 == 0 { outer } else { inner };
            let _ = writeln!(text, "G1 X{x:.4} Z{z:.5} F{feed:.1}");
        }
        text
    }

    /// The spark-out again, with as many strokes as it has, and at least two.
    fn sweep(&self) -> String {
        let ([inner, outer], feed) = (self.ends(), self.feed());
        let sweep_s = 2.0 * self.settings.sweep_mm / self.settings.sweep_mm_s;
        let count = libm::ceil(self.lap.spark_out_s / sweep_s).max(1.0) as usize;
        let sweep = format!("G1 X{outer:.4} F{feed:.1}\nG1 X{inner:.4}\n");
        let spindle = self.spindle();
        format!("G21 G90 G94\n{spindle}\n{}", sweep.repeat(count))
    }

    /// Starts the lap, which stops at the end of each program.
    fn spindle(&self) -> String {
        let way = if self.lap.rpm < 0.0 { "M4" } else { "M3" };
        format!("S{:.0} {way}", self.lap.rpm.abs())
    }

    fn retract(&self) -> String {
        format!("G21 G90\nG0 Z{:.4}\n", self.retracted)
    }
}

/// Angle between two unit vectors, degrees.
#[must_use]
pub fn angle_between(a: Vector, b: Vector) -> f64 {
    let sum = length([a[0] + b[0], a[1] + b[1], a[2] + b[2]]);
    let difference = length([a[0] - b[0], a[1] - b[1], a[2] - b[2]]);
    2.0 * libm::atan2(difference, sum) / RADIAN
}

/// A normal as angle from the plane of the girdle and azimuth, degrees.
#[must_use]
pub fn angles(normal: Vector) -> [f64; 2] {
    let across = libm::hypot(normal[0], normal[1]);
    let angle = libm::atan2(across, normal[2].abs()) / RADIAN;
    [angle, libm::atan2(normal[1], normal[0]) / RADIAN]
}

/// A body in the frame of the design, from the frame of the tip.
#[must_use]
pub fn in_design(stone: &Polyhedron, mount: &Mount) -> Polyhedron {
    stone.moved(&mount.axes(), [0.0; 3])
}
