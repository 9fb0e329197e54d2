//! Calibration of the H-4 arm: its true lengths and the offsets of its joints, found by a fit to
//! the readings of a laser tracker, and written as keys of its machine file.
//!
//! A parallel arm has no error functions of single axes. The controller moves the arm to poses
//! about its home pose; the tracker reads the tip at each standstill, the controller the joints.
//! The fit minimises the distances between the readings and the tip of an arm with other lengths
//! (forward kinematics of the simulator). Other poses then show the error of the tip before and
//! after.

use crate::drive::{Machine, SLOW};
use crate::noise::Noise;
use crate::observed::Sample;
use haptimill_client::{Error, ErrorKind, session};
use haptimill_hil_sim::config::PlantConfig;
use haptimill_hil_sim::joint::mechanics::JointArray;
use haptimill_hil_sim::machines::GeometryConfig;
use haptimill_hil_sim::machines::h4::ArmGeometry;
use haptimill_kinematics::{Kinematics, Pose};
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::model::Model;
use haptimill_machine_file::scale::per_unit;
use haptimill_math::Coordinate;
use haptimill_volumetric::Vector;
use haptimill_volumetric::grid::Sizes;
use nalgebra::{DMatrix, DVector, SVector};
use std::fmt;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use toml_edit::{DocumentMut, Item};

/// Parameters: length of the rods, half distance of the platform joints, offsets of rails and
/// carriages, x of the workpiece, and the offsets of the joints.
pub const NAMES: [&str; 9] = ["r", "c", "w", "ge", "x_off", "l1", "l2", "l3", "l4"];

/// What readings of the tip do not tell apart.
const ONLY_SUMS: &str = "Readings of the tip do not distinguish w from x_off: they give only w + x_off, \
                         l2 + 2 w and l4 + 2 w.";

/// Parameters that are lengths; the others are joint offsets.
const LENGTHS: usize = 5;

/// Changes of the parameters, mm.
pub type Parameters = [f64; NAMES.len()];

/// Coordinates of a pose that differ between the readings: x, y, z and the tilt of the tool.
const COORDINATES: usize = 4;

/// A reading: joints as the controller reports them, and the tip that the tracker sees, mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reading {
    /// Joint positions, mm and degrees.
    pub joints: JointArray,
    /// The tip in work coordinates.
    pub tip: Vector,
}

/// How to measure.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plan {
    /// Poses that are read, and poses at which the result is checked.
    pub poses: [usize; 2],
    /// Largest distance of a pose from the home pose in x, y and z, mm, and in tilt, degrees.
    pub reach: [f64; COORDINATES],
    /// Feed between poses, mm/s.
    pub feed: f64,
    /// Wait at a pose, and the part of it over which readings are averaged, seconds.
    pub wait: [f64; 2],
    /// Standard deviation of a coordinate that the tracker reads, mm.
    pub noise: f64,
    /// Seed of the poses and of the noise.
    pub seed: u64,
}

impl Default for Plan {
    fn default() -> Self {
        Self {
            poses: [40, 20],
            reach: [60.0, 60.0, 30.0, 8.0],
            feed: 50.0,
            wait: [0.8, 0.3],
            noise: 0.002,
            seed: 1,
        }
    }
}

/// A fitted arm.
#[derive(Debug, Clone, PartialEq)]
pub struct Fit {
    /// Changes of the parameters from their nominal values, mm.
    pub by: Parameters,
    /// Distances of the readings from the arm before the fit, mm.
    pub before: Sizes,
    /// The same after it.
    pub after: Sizes,
}

/// A calibrated arm.
#[derive(Debug, Clone, PartialEq)]
pub struct Calibration {
    /// The fit to the readings.
    pub fit: Fit,
    /// Errors of the tip at poses that were not read, before, mm.
    pub before: Sizes,
    /// The same with the calibrated machine file.
    pub after: Sizes,
    /// The machine with the fitted lengths and index positions.
    pub machine: MachineFile,
}

impl fmt::Display for Calibration {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "parameter   change, mm")?;
        for (name, by) in NAMES.iter().zip(&self.fit.by) {
            writeln!(f, "{name:<11} {by:>10.4}")?;
        }
        writeln!(f, "{ONLY_SUMS}")?;
        writeln!(f, "\ndistance, um                       largest      rms")?;
        for (name, sizes) in [
            ("readings from the arm, before", self.fit.before),
            ("readings from the arm, after", self.fit.after),
            ("error of the tip elsewhere, before", self.before),
            ("error of the tip elsewhere, after", self.after),
        ] {
            let (largest, rms) = (sizes.largest * 1e3, sizes.rms * 1e3);
            writeln!(f, "{name:<34} {largest:>7.1} {rms:>8.1}")?;
        }
        Ok(())
    }
}

/// Which of the two arms of a machine file changes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Part {
    /// That of the controller: `[kinematics]`, and `index_mm` of the joints.
    Controller,
    /// The simulated one.
    Plant,
}

/// Lengths of the arm that the controller assumes, in the form of the simulator.
fn nominal(machine: &MachineFile) -> Result<ArmGeometry, Error> {
    let plant: PlantConfig = machine.plant()?;
    let Some(GeometryConfig::H4(mut geometry)) = plant.geometry else {
        let what = "the simulated machine is no H-4 arm; name one with [plant.geometry.h4], such as \
                    machines/h4.toml";
        return Err(Error::in_file(&machine.file, what));
    };
    let document = parsed(machine)?;
    let length = |key: &str| number(&document["kinematics"][key]);
    for (key, value) in [
        ("a", &mut geometry.a),
        ("b", &mut geometry.b),
        ("c", &mut geometry.c),
        ("d", &mut geometry.d),
        ("e", &mut geometry.e),
        ("w", &mut geometry.w),
        ("r", &mut geometry.r),
        ("ge", &mut geometry.ge),
        ("tl", &mut geometry.tl),
        ("p", &mut geometry.p),
        ("h", &mut geometry.h),
        ("x_off", &mut geometry.x_off),
        ("y_off", &mut geometry.y_off),
        ("z_off", &mut geometry.z_off),
    ] {
        *value = length(key).ok_or_else(|| missing(machine, &format!("kinematics.{key}")))?;
    }
    Ok(geometry)
}

fn parsed(machine: &MachineFile) -> Result<DocumentMut, Error> {
    let parsed = machine.text.parse();
    parsed.map_err(|error: toml_edit::TomlError| Error::in_file(&machine.file, error))
}

fn number(item: &Item) -> Option<f64> {
    item.as_float()
        .or_else(|| item.as_integer().map(|number| number as f64))
}

fn missing(machine: &MachineFile, key: &str) -> Error {
    Error::in_file(
        &machine.file,
        format!("{key} is missing; see machines/h4.toml"),
    )
}

/// Adds to a number of a machine file, rounded to 1 nm. Its comment stays.
fn add(item: Option<&mut Item>, by: f64) -> Option<()> {
    let item = item?;
    let before = number(item)?;
    let value = item.as_value_mut()?;
    let decor = value.decor().clone();
    *value = (((before + by) * 1e6).round() / 1e6).into();
    *value.decor_mut() = decor;
    Some(())
}

/// The machine with changed parameters of one of its two arms.
fn changed_file(machine: &MachineFile, part: Part, by: &Parameters) -> Result<MachineFile, Error> {
    let mut document = parsed(machine)?;
    for (name, by) in NAMES.iter().zip(by).take(LENGTHS) {
        let section = match part {
            Part::Controller => document.get_mut("kinematics"),
            Part::Plant => document
                .get_mut("plant")
                .and_then(|plant| plant.get_mut("geometry")?.get_mut("h4")),
        };
        let length = section.and_then(|section| section.get_mut(name));
        add(length, *by).ok_or_else(|| missing(machine, name))?;
    }
    let joints = match part {
        Part::Controller => document.get_mut("joint"),
        Part::Plant => document
            .get_mut("plant")
            .and_then(|plant| plant.get_mut("joint")),
    };
    let joints = joints.and_then(Item::as_array_of_tables_mut);
    for table in joints.into_iter().flat_map(|joints| joints.iter_mut()) {
        let name = table.get("name").and_then(Item::as_str).unwrap_or_default();
        let Some(index) = NAMES.iter().position(|parameter| *parameter == name) else {
            continue;
        };
        let place = match part {
            Part::Controller => table.get_mut("index_mm"),
            Part::Plant => table
                .get_mut("encoder")
                .and_then(|encoder| encoder.get_mut("index")),
        };
        add(place, by[index])
            .ok_or_else(|| missing(machine, &format!("index of {}", NAMES[index])))?;
    }
    Ok(MachineFile::parse(&machine.file, &document.to_string())?)
}

/// The machine whose simulated arm has other lengths and index positions than the controller
/// assumes, each by at most `by` mm.
///
/// # Errors
/// The simulated machine is no H-4 arm.
pub fn perturbed(machine: &MachineFile, by: f64, seed: u64) -> Result<MachineFile, Error> {
    nominal(machine)?;
    let mut noise = Noise::new(seed, 4001);
    let by = [0.0; NAMES.len()].map(|_| by * noise.uniform());
    changed_file(machine, Part::Plant, &by)
}

/// The geometry with changed parameters, and the joints with their offsets.
fn changed(
    nominal: &ArmGeometry,
    by: &Parameters,
    joints: &JointArray,
) -> (ArmGeometry, JointArray) {
    let mut geometry = nominal.clone();
    let [r, c, w, ge, x_off, ..] = *by;
    geometry.r += r;
    geometry.c += c;
    geometry.w += w;
    geometry.ge += ge;
    geometry.x_off += x_off;
    let mut joints = *joints;
    joints
        .iter_mut()
        .zip(&by[LENGTHS..])
        .for_each(|(joint, offset)| *joint += offset);
    (geometry, joints)
}

/// The tip of the arm with changed parameters; `None` where it cannot be assembled.
fn tip(nominal: &ArmGeometry, by: &Parameters, joints: &JointArray) -> Option<Vector> {
    let (geometry, joints) = changed(nominal, by, joints);
    let pose = GeometryConfig::H4(geometry).pose(&joints)?;
    Some(Vector::new(pose[0], pose[1], pose[2]))
}

/// Steps of Levenberg and Marquardt.
const STEPS: usize = 40;

/// Step of a parameter for the slopes, mm.
const SLOPE_STEP: f64 = 1e-4;

/// Fits the parameters to readings by the method of Levenberg and Marquardt; `None` where the arm
/// cannot be assembled at a reading.
#[must_use]
pub fn fit(nominal: &ArmGeometry, readings: &[Reading]) -> Option<Fit> {
    let residuals = |by: &Parameters| -> Option<DVector<f64>> {
        let mut all = Vec::with_capacity(3 * readings.len());
        for reading in readings {
            let off = reading.tip - tip(nominal, by, &reading.joints)?;
            all.extend(off.iter());
        }
        Some(DVector::from_vec(all))
    };
    let mut by = [0.0; NAMES.len()];
    let mut now = residuals(&by)?;
    let before = distances(&now);
    let mut damping = 1e-3;
    for _ in 0..STEPS {
        let mut slopes = DMatrix::zeros(now.len(), NAMES.len());
        for (parameter, mut slope) in slopes.column_iter_mut().enumerate() {
            let mut moved = by;
            moved[parameter] += SLOPE_STEP;
            slope.copy_from(&((&now - residuals(&moved)?) / SLOPE_STEP));
        }
        let mut matrix = slopes.tr_mul(&slopes);
        for parameter in 0..NAMES.len() {
            matrix[(parameter, parameter)] *= 1.0 + damping;
        }
        let step = matrix.lu().solve(&slopes.tr_mul(&now))?;
        let next: Parameters = (SVector::from(by) + SVector::from_fn(|row, _| step[row])).into();
        match residuals(&next) {
            Some(changed) if changed.norm_squared() < now.norm_squared() => {
                (by, now) = (next, changed);
                damping *= 0.2;
            }
            _ => damping *= 10.0,
        }
        if damping > 1e6 {
            break;
        }
    }
    Some(Fit {
        by,
        before,
        after: distances(&now),
    })
}

/// Sizes of vectors that follow each other.
fn distances(residuals: &DVector<f64>) -> Sizes {
    let (vectors, _) = residuals.as_slice().as_chunks::<3>();
    Sizes::of(vectors.iter().map(|vector| Vector::from(*vector)))
}

/// Random poses about the home pose that the joints can take: x, y, z, mm, and tilt, degrees.
fn poses(
    machine: &MachineFile,
    plan: &Plan,
    count: usize,
    stream: u64,
) -> Result<Vec<[f64; COORDINATES]>, Error> {
    let home = session::find_home_pose(machine, &Model::new(machine))?;
    let kinematics = machine.config.kinematics();
    let mut noise = Noise::new(plan.seed, stream);
    let mut all = Vec::new();
    // A pose in ten is out of reach at most; the bound ends the search on an unusual machine.
    for _ in 0..100 * count {
        let mut pose = Pose::default();
        let mut values = [0.0; COORDINATES];
        for (axis, value) in home.iter().enumerate() {
            pose.0[axis] = Coordinate(*value);
            let (Some(reach), Some(limits)) = (plan.reach.get(axis), machine.config.pose.get(axis))
            else {
                continue;
            };
            let unit = per_unit(limits.kind);
            values[axis] = f64::from(*value) / unit + reach * noise.uniform();
            pose.0[axis] = Coordinate((values[axis] * unit) as i32);
        }
        if all.len() < count && kinematics.inverse(&pose).is_ok() {
            all.push(values);
        }
    }
    if all.len() < count {
        let what = "the arm reaches too few poses about its home pose; move its presets";
        return Err(Error::in_file(&machine.file, what));
    }
    // In the order of the tilt: its rate stays low on the way from pose to pose.
    all.sort_by(|a, b| a[COORDINATES - 1].total_cmp(&b[COORDINATES - 1]));
    Ok(all)
}

/// The tip of a sample.
fn tip_of(sample: &Sample) -> Vector {
    Vector::new(sample.tool[0], sample.tool[1], sample.tool[2])
}

fn visit(
    machine: &mut Machine,
    plan: &Plan,
    poses: &[[f64; COORDINATES]],
) -> Result<Vec<Sample>, Error> {
    let [wait, window] = plan.wait;
    machine.visit(poses, plan.feed, wait, window)
}

/// Errors of the tip at poses, mm.
fn errors_at(
    machine: &mut Machine,
    plan: &Plan,
    poses: &[[f64; COORDINATES]],
) -> Result<Sizes, Error> {
    let samples = visit(machine, plan, poses)?;
    let errors = samples.iter().zip(poses);
    Ok(Sizes::of(errors.map(|(sample, [x, y, z, _])| {
        tip_of(sample) - Vector::new(*x, *y, *z)
    })))
}

/// Moves the arm to poses, fits its parameters to the readings of a tracker, and moves the
/// calibrated arm to other poses.
///
/// # Errors
/// The machine is no simulated H-4 arm; a run fails; the readings are those of no arm.
pub fn calibrate(
    file: &MachineFile,
    plan: &Plan,
    interrupted: &Arc<AtomicBool>,
    mut progress: impl FnMut(&str),
) -> Result<Calibration, Error> {
    let nominal = nominal(file)?;
    let read_at = poses(file, plan, plan.poses[0], 4002)?;
    let checked_at = poses(file, plan, plan.poses[1], 4003)?;
    progress(&format!("{} poses with readings", read_at.len()));
    let mut machine = Machine::new(file, SLOW, interrupted)?;
    let mut noise = Noise::new(plan.seed, 4000);
    let readings: Vec<Reading> = visit(&mut machine, plan, &read_at)?
        .iter()
        .map(|sample| Reading {
            joints: sample.reported,
            tip: tip_of(sample).map(|place| place + noise.normal(plan.noise)),
        })
        .collect();
    let fit = fit(&nominal, &readings).ok_or_else(|| {
        let what = "no arm fits the readings; check the lengths in [kinematics]";
        Error::new(ErrorKind::BadInput, format!("{}: {what}", file.file))
    })?;
    progress(&format!(
        "{} other poses, before and after",
        checked_at.len()
    ));
    let before = errors_at(&mut machine, plan, &checked_at)?;
    let calibrated = changed_file(file, Part::Controller, &fit.by)?;
    let mut machine = Machine::new(&calibrated, SLOW, interrupted)?;
    Ok(Calibration {
        after: errors_at(&mut machine, plan, &checked_at)?,
        before,
        fit,
        machine: calibrated,
    })
}
