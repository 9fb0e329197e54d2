//! Passes in which a person leads the tool by the haptic arm, or feels a wall there.
//!
//! The part program of such a pass has two pauses (M0). At the first the hand takes over: the coordinates that it leads change their source, the wall is put up, the button is pressed, and the
//! person forms the intention. At the second it lets go, and the program leads all coordinates again from where they are.
//!
//! One hand serves all of them, that of the machine file; what differs is what the person means to do, and the settings that the thesis states.

use haptimill_client::session::{HapticTrace, Session, SimLine};
use haptimill_client::{Error, ErrorKind};
use haptimill_hil_sim::haptics::HapticArm;
use haptimill_hil_sim::operator::{Rail, ReferencePart, Stroke, Trace, Trajectory};
use haptimill_hil_sim::rig::Control;
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::scale::{PER_EFFORT, to_i32};
use haptimill_protocol::haptic::{ForceFeedback, ForceFeedbackAxis, VirtualFixture};
use haptimill_protocol::message::{Command, RATE_SHIFT, Source};

/// What the hand leads in a pass, what it feels, and what it means to do.
#[derive(Debug, Clone, Copy)]
pub struct Led {
    /// Pose coordinates that it leads.
    pub axes: &'static [u8],
    /// Axes of the work along which the tool yields, where there is force control.
    pub yields: &'static [u8],
    /// The way of the rail under the handle, if there is one.
    pub rail: Option<[f64; 3]>,
    /// The reference part is clamped at the tip.
    pub part: bool,
    /// Percent of the force on the tool along x, y, z that it feels, and the most of it, N.
    pub reflect: [(u8, f64); 3],
    /// Force against its motion where the reflection is too weak to be felt, N s/mm; 0 for none.
    pub boost: f64,
    /// A wall that moves along x at this rate from where the handle is, mm/s; below it the hand is pushed back.
    pub wall_mm_s: Option<f64>,
    /// What the person means to do.
    pub trajectory: fn() -> Trajectory,
}

/// Where the boost ends, N: what is stronger is clearly felt (docs/control.md 3.4).
const BOOST_BELOW: f64 = 2.0;

impl PartialEq for Led {
    fn eq(&self, other: &Self) -> bool {
        let key = |led: &Self| {
            let (axes, yields, rail, part) = (led.axes, led.yields, led.rail, led.part);
            let feels = (led.reflect, led.boost, led.wall_mm_s);
            (axes, yields, rail, part, feels)
        };
        key(self) == key(other) && (self.trajectory)() == (other.trajectory)()
    }
}

/// Why a scenario with a hand is not run.
pub const NO_HAPTIC_ARM: &str = "this machine has no haptic arm";

/// The handle along a rail towards -X, 30 mm, to and fro as often as there are times; a person who begins gently and is fastest late, as the thesis's (E8: 3 to 4.5 s).
fn strokes(times: &[f64]) -> Trajectory {
    let stroke = |(index, at_s): (usize, &f64)| Stroke {
        at_s: *at_s,
        to_mm: [if index % 2 == 0 { -30.0 } else { 0.0 }, 0.0, 0.0],
        pace_mm_s: 14.0,
        ramp_s: 3.0,
    };
    Trajectory::Strokes(times.iter().enumerate().map(stroke).collect())
}

/// E6: away as fast as the stated 20 mm in the first second ask for.
#[must_use]
pub fn swiftly() -> Trajectory {
    Trajectory::Strokes(vec![Stroke {
        at_s: 0.0,
        to_mm: [-60.0, 0.0, 0.0],
        pace_mm_s: 26.0,
        ramp_s: 0.2,
    }])
}

/// E6: slower than the wall.
#[must_use]
pub fn slowly() -> Trajectory {
    Trajectory::Strokes(vec![Stroke {
        at_s: 0.0,
        to_mm: [-12.0, 0.0, 0.0],
        pace_mm_s: 3.0,
        ramp_s: 0.2,
    }])
}

/// E8: once.
#[must_use]
pub fn once() -> Trajectory {
    strokes(&[0.0])
}

/// E10: there, back and there again, each when the program has gone sideways.
#[must_use]
pub fn three_times() -> Trajectory {
    strokes(&[0.0, 9.0, 19.0])
}

/// E12: round in the reference part, first towards -X and -Y.
#[must_use]
pub fn round() -> Trajectory {
    let part = ReferencePart::default();
    Trajectory::Trace(Trace {
        at_s: 0.5,
        centre_mm: part.centre_mm,
        radius_mm: part.path_radius(),
        turns: -1.0,
        pace_mm_s: 5.5,
        ramp_s: 1.0,
        press_n: 2.0,
    })
}

/// The simulated arm of a session.
fn arm<C: Control>(session: &mut Session<SimLine<C>>) -> Result<&mut HapticArm, Error> {
    let plant = session.line_mut().rig_mut().plant_mut();
    plant
        .haptic_mut()
        .ok_or_else(|| Error::new(ErrorKind::Refused, NO_HAPTIC_ARM))
}

fn nonsense(problems: Vec<haptimill_hil_sim::check::PlantError>) -> Error {
    let problems: Vec<String> = problems.iter().map(ToString::to_string).collect();
    Error::new(ErrorKind::Internal, problems.join("\n"))
}

impl Led {
    /// Whether a machine can run it: with a haptic arm of its own, or with the reference one.
    #[must_use]
    pub fn fits(machine: &MachineFile) -> bool {
        machine.with_hand().is_ok()
    }

    /// Rail and part are mounted, and the controller is told what the hand shall feel.
    ///
    /// # Errors
    /// There is no haptic arm, or the controller refuses.
    pub fn set_up<C: Control>(&self, session: &mut Session<SimLine<C>>) -> Result<(), Error> {
        let (rail, part) = (self.rail, self.part);
        let arm = arm(session)?;
        arm.fit_rail(rail.map(Rail::along)).map_err(nonsense)?;
        arm.clamp_part(part.then(ReferencePart::default))
            .map_err(nonsense)?;
        let newtons = |force: f64| to_i32(force * PER_EFFORT);
        session.ask(Command::ForceFeedback(ForceFeedback {
            axes: self.reflect.map(|(percent, most)| ForceFeedbackAxis {
                percent,
                limit: newtons(most),
            }),
            damping: newtons(self.boost).clamp(0, i32::from(u16::MAX)) as u16,
            damping_below: newtons(BOOST_BELOW),
        }))
    }

    /// The hand takes over.
    ///
    /// # Errors
    /// The controller refuses.
    pub fn begin<C: Control>(&self, session: &mut Session<SimLine<C>>) -> Result<(), Error> {
        for axis in self.axes {
            session.ask(Command::Source {
                axis: *axis,
                source: Source::Master,
            })?;
        }
        if let Some(rate) = self.wall_mm_s {
            session.ask(Command::VirtualFixture {
                axis: 0,
                upper: rate > 0.0,
                fixture: Some(VirtualFixture {
                    at: None,
                    rate: (rate * haptimill_machine_file::scale::PER_MM
                        / f64::from(1 << RATE_SHIFT))
                    .round() as i32,
                }),
            })?;
        }
        session.line_mut().begin_haptic_trace();
        let arm = arm(session)?;
        arm.set_engaged(true);
        arm.set_trajectory((self.trajectory)());
        Ok(())
    }

    /// The hand lets go; gives what was seen meanwhile.
    ///
    /// # Errors
    /// The controller refuses.
    pub fn end<C: Control>(
        &self,
        session: &mut Session<SimLine<C>>,
    ) -> Result<Option<HapticTrace>, Error> {
        let course = session.line_mut().end_haptic_trace();
        arm(session)?.set_engaged(false);
        if self.wall_mm_s.is_some() {
            for upper in [false, true] {
                session.ask(Command::VirtualFixture {
                    axis: 0,
                    upper,
                    fixture: None,
                })?;
            }
        }
        for axis in self.axes {
            session.ask(Command::Source {
                axis: *axis,
                source: Source::Program,
            })?;
        }
        Ok(course)
    }
}
