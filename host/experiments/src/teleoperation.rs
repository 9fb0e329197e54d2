//! Passes in which an operator moves the tool with the haptic arm, or pushes against a virtual
//! fixture.
//!
//! The part program of such a pass has two pauses (M0). At the first, the master becomes the source
//! of its coordinates, the virtual fixture is set, the enabling switch is pressed, and the operator
//! trajectory starts. At the second, the program becomes the source of all coordinates again.
//!
//! All passes use the operator model of the machine file; they differ in operator trajectory and
//! settings.

use super::definition::Teleoperation;
use super::obstacle::NO_HAPTIC_ARM;
use haptimill_client::session::{HapticTrace, Session, SimLine};
use haptimill_client::{Error, ErrorKind};
use haptimill_hil_sim::haptics::HapticArm;
use haptimill_hil_sim::operator::{Rail, ReferencePart};
use haptimill_hil_sim::rig::Control;
use haptimill_machine_file::scale::{PER_EFFORT, PER_MM, to_i32};
use haptimill_protocol::haptic::{ForceFeedback, ForceFeedbackAxis, VirtualFixture};
use haptimill_protocol::message::{Command, RATE_SHIFT, Source};

/// Force feedback at which the damping term has faded out, N (docs/control.md 3.4).
const DAMPING_BELOW_N: f64 = 2.0;

/// The simulated haptic arm of a session.
fn arm<C: Control>(session: &mut Session<SimLine<C>>) -> Result<&mut HapticArm, Error> {
    let plant = session.line_mut().rig_mut().plant_mut();
    plant
        .haptic_mut()
        .ok_or_else(|| Error::new(ErrorKind::Refused, NO_HAPTIC_ARM))
}

fn plant_error(problems: Vec<haptimill_hil_sim::check::PlantError>) -> Error {
    let problems: Vec<String> = problems.iter().map(ToString::to_string).collect();
    Error::new(ErrorKind::Internal, problems.join("\n"))
}

/// Mounts rail and reference part, and sends the force feedback settings.
///
/// # Errors
/// There is no haptic arm, or the controller refuses.
pub fn set_up<C: Control>(
    settings: &Teleoperation,
    session: &mut Session<SimLine<C>>,
) -> Result<(), Error> {
    let arm = arm(session)?;
    arm.fit_rail(settings.rail.map(Rail::along))
        .map_err(plant_error)?;
    arm.clamp_part(settings.reference_part.then(ReferencePart::default))
        .map_err(plant_error)?;
    let newtons = |force: f64| to_i32(force * PER_EFFORT);
    session.ask(Command::ForceFeedback(ForceFeedback {
        axes: settings.feedback.axes().map(|axis| ForceFeedbackAxis {
            percent: axis.percent,
            limit: newtons(axis.limit_n),
        }),
        damping: newtons(settings.damping).clamp(0, i32::from(u16::MAX)) as u16,
        damping_below: newtons(DAMPING_BELOW_N),
    }))
}

/// Makes the master the source of its coordinates, and starts the operator trajectory.
///
/// # Errors
/// The controller refuses.
pub fn begin<C: Control>(
    settings: &Teleoperation,
    session: &mut Session<SimLine<C>>,
) -> Result<(), Error> {
    set_source(settings, session, Source::Master)?;
    if let Some(rate) = settings.fixture_mm_s {
        session.ask(Command::VirtualFixture {
            axis: 0,
            upper: rate > 0.0,
            fixture: Some(VirtualFixture {
                at: None,
                rate: (rate * PER_MM / f64::from(1 << RATE_SHIFT)).round() as i32,
            }),
        })?;
    }
    session.line_mut().begin_haptic_trace();
    let arm = arm(session)?;
    arm.set_enabling_switch(true);
    arm.set_trajectory(settings.operator.clone());
    Ok(())
}

/// Makes the program the source of all coordinates; returns the record of master and tool.
///
/// # Errors
/// The controller refuses.
pub fn end<C: Control>(
    settings: &Teleoperation,
    session: &mut Session<SimLine<C>>,
) -> Result<Option<HapticTrace>, Error> {
    let record = session.line_mut().end_haptic_trace();
    arm(session)?.set_enabling_switch(false);
    if settings.fixture_mm_s.is_some() {
        for upper in [false, true] {
            session.ask(Command::VirtualFixture {
                axis: 0,
                upper,
                fixture: None,
            })?;
        }
    }
    set_source(settings, session, Source::Program)?;
    Ok(record)
}

fn set_source<C: Control>(
    settings: &Teleoperation,
    session: &mut Session<SimLine<C>>,
    source: Source,
) -> Result<(), Error> {
    for axis in &settings.axes {
        session.ask(Command::Source {
            coordinate: *axis as u8,
            source,
        })?;
    }
    Ok(())
}
