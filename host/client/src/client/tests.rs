//! The client against a controller side whose link, setpoint decoder and stop are real. Its motion
//! is simplified: a setpoint is reached when its time has passed.

#[path = "../../../../protocol/tests/line/mod.rs"]
mod line;
mod responder;

use super::*;
use haptimill_protocol::link::{ControllerLink, HelloOutcome, Identity, SHORT_REPORT, Timing};
use haptimill_protocol::message::{Action, DriveAlarm, HelloRefusal, InputProblem};
use haptimill_protocol::message::{Event, Report, State};
use haptimill_protocol::out_of_band::StopDetector;
use haptimill_protocol::setpoint::Setpoint;
use haptimill_protocol::setpoint::SetpointCoder;
use line::{Faults, Line, Random};
use responder::{QUEUE, Responder};

/// Client, responder, and the lines between them.
struct World {
    client: Client,
    responder: Responder,
    out: Line,
    back: Line,
    now_us: u64,
    notices: Vec<Notification>,
}

impl World {
    fn new(seed: u64, faults: Faults) -> Self {
        let mut options = Options::default();
        options.timing.line_rate = 11_520;
        let mut client = Client::new(options);
        client.connect(seed as u32, 0);
        Self {
            client,
            responder: Responder::new(),
            out: Line::new(seed, 11_520, faults),
            back: Line::new(!seed, 11_520, faults),
            now_us: 0,
            notices: Vec::new(),
        }
    }

    /// The same with an open session.
    fn connected(seed: u64, faults: Faults) -> Self {
        let mut world = Self::new(seed, faults);
        world.until(3_000_000, |world| {
            *world.client.state() == ClientState::Ready
        });
        world
    }

    /// Steps until a condition holds; false if it does not within the limit.
    fn until(&mut self, limit_us: u64, done: impl Fn(&Self) -> bool) -> bool {
        let end = self.now_us + limit_us;
        let mut buffer = [0; 64];
        while self.now_us < end {
            self.now_us += 200;
            // The host is called every 2 ms, the controller every period.
            if self.now_us.is_multiple_of(2000) {
                let received = self.back.take(self.now_us, usize::MAX);
                let mut transmit = Vec::new();
                self.client.advance(self.now_us, &received, &mut transmit);
                self.out.send(self.now_us, &transmit);
                while let Some(notification) = self.client.poll() {
                    self.notices.push(notification);
                }
            }
            let bytes = self.out.take(self.now_us, 64);
            let count = self.responder.period(self.now_us, &bytes, &mut buffer);
            self.back.send(self.now_us, &buffer[..count]);
            if done(self) {
                return true;
            }
        }
        false
    }

    fn answer(&self, ticket: Ticket) -> Option<&Result<(), RequestError>> {
        self.notices
            .iter()
            .find_map(|notification| match notification {
                Notification::Answered {
                    ticket: answered,
                    result,
                    ..
                } if *answered == ticket => Some(result),
                _ => None,
            })
    }

    fn ending(&self) -> Option<&JobEnding> {
        self.notices
            .iter()
            .rev()
            .find_map(|notification| match notification {
                Notification::Job(ending) => Some(ending),
                _ => None,
            })
    }
}

/// A smooth path of two axes with an action here and there, 20 ms a setpoint.
fn path(seed: u64, count: u32) -> Vec<Setpoint> {
    let mut random = Random::new(seed);
    let (mut x, mut v) = (0i32, 0i32);
    (0..count)
        .map(|number| {
            v = (v + random.below(400) as i32 - 200).clamp(-20_000, 20_000);
            x += v * 5;
            Setpoint {
                periods: 100,
                pose: [x, 7].into_iter().collect(),
                rates: [v, 0].into_iter().collect(),
                action: if number % 50 == 3 {
                    Action::Spindle(number as i16)
                } else {
                    Action::None
                },
            }
        })
        .collect()
}

fn pose() -> AxisValues {
    [0, 7].into_iter().collect()
}

#[test]
fn a_job_arrives_unchanged_over_any_line() {
    let lines = [
        Faults::default(),
        Faults {
            bit_error: 1e-6,
            ..Faults::default()
        },
        Faults {
            bit_error: 1e-4,
            ..Faults::default()
        },
        Faults {
            bit_error: 1e-3,
            ..Faults::default()
        },
        Faults {
            frame: 0.05,
            ..Faults::default()
        },
        Faults {
            byte_loss: 1e-3,
            ..Faults::default()
        },
    ];
    for (index, faults) in lines.into_iter().enumerate() {
        let seed = 100 + index as u64;
        let mut world = World::connected(seed, faults);
        for job in [1, 2] {
            let path = path(seed + u64::from(job), 250);
            world.responder.reached.clear();
            world.client.start_job(job, pose(), path.clone()).unwrap();
            assert!(
                world.until(60_000_000, |world| world.client.job().is_none()),
                "{faults:?}: {:?}",
                world.client.job()
            );
            assert_eq!(
                world.ending(),
                Some(&JobEnding::Done {
                    job,
                    setpoints: 250
                }),
                "{faults:?}"
            );
            assert_eq!(world.responder.reached, path, "{faults:?}");
        }
        assert!(!world.notices.iter().any(|notification| matches!(
            notification,
            Notification::Refused(_) | Notification::Lost(_)
        )));
    }
}

#[test]
fn the_queue_never_underruns_on_a_good_line() {
    let mut world = World::connected(9, Faults::default());
    world.client.start_job(1, pose(), path(9, 500)).unwrap();
    assert!(
        world.until(1_000_000, |world| world.responder.queue.len() as u32
            >= QUEUE / 2)
    );
    let low = std::cell::Cell::new(u32::MAX);
    world.until(60_000_000, |world| {
        if world.client.job().is_some_and(|job| !job.complete) {
            low.set(low.get().min(world.responder.queue.len() as u32));
        }
        world.client.job().is_none()
    });
    assert!(low.get() >= QUEUE / 2, "{}", low.get());
}

#[test]
fn a_configuration_is_sent_once() {
    let config: Vec<u8> = (0..700u32).map(|k| (k * k) as u8).collect();
    let mut world = World::connected(
        1,
        Faults {
            bit_error: 3e-4,
            ..Faults::default()
        },
    );
    let first = world.client.configure(&config, false);
    assert!(world.until(5_000_000, |world| world.answer(first).is_some()));
    assert_eq!(world.answer(first), Some(&Ok(())));
    assert_eq!(world.responder.config, config);
    let again = world.client.configure(&config, false);
    assert!(world.until(10_000, |world| world.answer(again) == Some(&Ok(()))));
    // A new session with a controller that has it already.
    world.client.connect(0xabcd, world.now_us);
    assert!(world.until(2_000_000, |world| *world.client.state()
        == ClientState::Ready));
    let third = world.client.configure(&config, false);
    assert!(world.until(10_000, |world| world.answer(third) == Some(&Ok(()))));
    assert_eq!(world.responder.activated, 1);
}

#[test]
fn requests_are_acknowledged_refused_or_time_out() {
    let mut world = World::connected(2, Faults::default());
    world.responder.mute = Some("enable");
    let tickets = [
        Command::Ping,
        Command::Home,
        Command::Enable,
        Command::Status,
    ]
    .map(|command| world.client.request(command));
    assert!(world.until(5_000_000, |world| {
        tickets.iter().all(|&ticket| world.answer(ticket).is_some())
    }));
    assert_eq!(world.answer(tickets[0]), Some(&Ok(())));
    assert_eq!(
        world.answer(tickets[1]),
        Some(&Err(RequestError::Refused(Refusal::NotHomed)))
    );
    let late = world.answer(tickets[2]).unwrap().clone().unwrap_err();
    assert_eq!(
        late.to_string(),
        "the controller did not answer the command 'enable' within 2.0 s"
    );
    assert_eq!(world.answer(tickets[3]), Some(&Ok(())));
}

/// An enabling that is refused because of a driver chip is repeated for a second, and no longer
/// after another command about the drives.
#[test]
fn an_enabling_waits_for_the_driver_chips() {
    let refused = |answer: Option<&Result<(), RequestError>>| {
        matches!(answer, Some(Err(RequestError::Refused(Refusal::Input(_)))))
    };
    let mut world = World::connected(4, Faults::default());
    world.responder.refused_enables = 5;
    let enable = world.client.request(Command::Enable);
    assert!(world.until(1_000_000, |world| world.answer(enable) == Some(&Ok(()))));
    let times = &world.responder.enables;
    assert_eq!(times.len(), 6);
    assert!(times.windows(2).all(|pair| pair[1] - pair[0] >= 20_000));

    world.responder.refused_enables = usize::MAX;
    let begun = world.now_us;
    let enable = world.client.request(Command::Enable);
    assert!(world.until(2_000_000, |world| refused(world.answer(enable))));
    let waited = world.now_us - begun;
    assert!((1_000_000..1_100_000).contains(&waited), "{waited} us");

    let enable = world.client.request(Command::Enable);
    world.until(100_000, |_| false);
    assert!(world.answer(enable).is_none());
    let disable = world.client.request(Command::Disable);
    assert!(world.until(100_000, |world| world.answer(disable).is_some()));
    assert!(refused(world.answer(enable)));
    let count = world.responder.enables.len();
    world.until(200_000, |_| false);
    assert_eq!(world.responder.enables.len(), count, "it is not repeated");
}

#[test]
fn hundreds_of_requests_get_their_own_acknowledgements() {
    let mut world = World::connected(
        3,
        Faults {
            bit_error: 1e-4,
            frame: 0.02,
            ..Faults::default()
        },
    );
    let tickets: Vec<(Ticket, bool)> = (0..400)
        .map(|number| {
            let home = number % 3 == 0;
            (
                world
                    .client
                    .request(if home { Command::Home } else { Command::Ping }),
                home,
            )
        })
        .collect();
    assert!(world.until(60_000_000, |world| {
        tickets
            .iter()
            .all(|&(ticket, _)| world.answer(ticket).is_some())
    }));
    for (ticket, home) in tickets {
        assert_eq!(world.answer(ticket).unwrap().is_err(), home);
    }
}

#[test]
fn an_urgent_stop_precedes_the_stream_and_is_repeated_until_standstill() {
    for seed in 0..20 {
        let faults = Faults {
            bit_error: 1e-3,
            ..Faults::default()
        };
        let mut world = World::connected(seed, faults);
        world.client.start_job(1, pose(), path(seed, 2000)).unwrap();
        assert!(world.until(20_000_000, |world| world.responder.done >= 20 + seed as u32));
        world.client.stop_out_of_band();
        let from = world.now_us;
        assert!(world.until(2_000_000, |world| world.responder.state != State::Run));
        // Bytes before it on the line take 20 ms; every stop that the line corrupts costs 20 ms
        // more.
        assert!(
            world.now_us - from <= 24_000 + 20_000 * u64::from(world.client.repeated_stop().1),
            "{} us",
            world.now_us - from
        );
        assert!(
            world.until(5_000_000, |world| !world.client.repeated_stop().0
                && world.client.job().is_none())
        );
        let done = world.responder.done;
        assert_eq!(
            world.ending(),
            Some(&JobEnding::Dropped {
                job: 1,
                setpoints: done
            })
        );
        assert_eq!(world.responder.state, State::Idle);
        world.until(500_000, |_| false);
        assert_eq!(world.responder.done, done);
    }
}

#[test]
fn an_urgent_stop_before_the_start_is_sent_withdraws_the_job() {
    let mut world = World::connected(4, Faults::default());
    world.client.start_job(1, pose(), path(4, 10)).unwrap();
    world.client.stop_out_of_band();
    assert!(world.until(1_000_000, |world| !world.client.repeated_stop().0));
    world.until(500_000, |_| false);
    assert_eq!(
        world.ending(),
        Some(&JobEnding::Refused {
            job: 1,
            error: RequestError::Withdrawn
        })
    );
    assert!(world.responder.reached.is_empty() && world.responder.stops_received > 0);
}

#[test]
fn no_jog_moves_after_its_cancel_was_received() {
    for seed in 0..40 {
        let mut world = World::connected(
            seed,
            Faults {
                frame: 0.2,
                bit_error: 1e-4,
                ..Faults::default()
            },
        );
        let rates: AxisValues = [4096, 0].into_iter().collect();
        for round in 0..6 {
            for _ in 0..=round {
                world.client.jog(rates.clone(), 200).unwrap();
                world.until(6_000 + 2_000 * (seed % 4), |_| false);
            }
            let cancel = world.client.cancel_jog();
            assert!(world.until(5_000_000, |world| world.answer(cancel).is_some()));
            let received = world.responder.jogs.len();
            // Jogs that still arrive have no effect.
            world.until(50_000, |_| false);
            assert_eq!(world.responder.jogs.len(), received);
            assert_eq!(world.responder.jog_left, 0);
        }
        assert!(!world.responder.jogs.is_empty());
    }
}

#[test]
fn a_missing_or_refusing_controller_is_reported() {
    let mut world = World::new(5, Faults::default());
    world.responder.dead = true;
    assert!(world.until(4_000_000, |world| matches!(
        world.client.state(),
        ClientState::Failed(_)
    )));
    let ClientState::Failed(error) = world.client.state() else {
        unreachable!()
    };
    assert_eq!(
        error.to_string(),
        "no controller answered within 3.0 s; check the port, its speed and the controller's power"
    );

    let mut world = World::new(6, Faults::default());
    world.responder.busy = true;
    assert!(world.until(4_000_000, |world| matches!(
        world.client.state(),
        ClientState::Failed(_)
    )));
    let ClientState::Failed(ClientError::Refused { why, .. }) = world.client.state() else {
        unreachable!()
    };
    assert_eq!(*why, HelloRefusal::Busy);
}

#[test]
fn a_silent_controller_ends_the_job_and_every_request() {
    let mut world = World::connected(7, Faults::default());
    world.client.start_job(3, pose(), path(7, 1000)).unwrap();
    assert!(world.until(5_000_000, |world| world.responder.done > 10));
    world.responder.dead = true;
    let ticket = world.client.request(Command::Hold);
    assert!(world.until(5_000_000, |world| matches!(
        world.client.state(),
        ClientState::Failed(ClientError::Silent { .. })
    )));
    assert!(matches!(
        world.ending(),
        Some(JobEnding::Lost { job: 3, .. })
    ));
    assert!(matches!(
        world.answer(ticket),
        Some(Err(RequestError::Lost(_)))
    ));
    assert!(matches!(
        world.notices.last(),
        Some(Notification::Lost(ClientError::Silent { .. }))
    ));
    assert_eq!(
        world.client.start_job(4, pose(), path(8, 1)),
        Err(ClientError::Closed)
    );
}

#[test]
fn a_refused_setpoint_ends_the_job_and_stops_the_machine() {
    let mut world = World::connected(8, Faults::default());
    let mut path = path(8, 100);
    path[40].periods = 0;
    world.client.start_job(5, pose(), path).unwrap();
    assert!(world.until(20_000_000, |world| world.client.job().is_none()));
    let error = haptimill_protocol::setpoint::SetpointError::NoTime;
    assert_eq!(
        world.ending(),
        Some(&JobEnding::Setpoint {
            job: 5,
            setpoint: 40,
            error
        })
    );
    assert!(world.until(1_000_000, |world| world.responder.state == State::Idle));
    // A job in a state in which none can start.
    world.responder.state = State::Fault;
    world
        .client
        .start_job(6, pose(), super::tests::path(1, 5))
        .unwrap();
    assert!(world.until(1_000_000, |world| world.client.job().is_none()));
    let error = RequestError::Refused(Refusal::State(State::Fault));
    assert_eq!(world.ending(), Some(&JobEnding::Refused { job: 6, error }));
}

#[test]
fn a_job_continues_while_telemetry_is_switched_off() {
    let mut world = World::connected(10, Faults::default());
    world.responder.every = 0;
    let path = path(10, 300);
    world.client.start_job(1, pose(), path.clone()).unwrap();
    assert!(world.until(30_000_000, |world| world.client.job().is_none()));
    assert_eq!(
        world.ending(),
        Some(&JobEnding::Done {
            job: 1,
            setpoints: 300
        })
    );
    assert_eq!(world.responder.reached, path);
    // 300 setpoints of 20 ms, without waiting for credit.
    assert!(world.now_us < 7_000_000, "{} us", world.now_us);
}
