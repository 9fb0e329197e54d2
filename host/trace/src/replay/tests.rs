use super::*;
use crate::tests::{TemporaryFile, header};
use crate::{IoLog, Recorder};
use haptimill_firmware::controller::Controller;
use haptimill_hil_sim::rig::{Rig, RigOptions};
use haptimill_machine_file::MachineFile;
use haptimill_protocol::link::{HostLink, Timing};
use haptimill_protocol::message::{CONFIG_CHUNK, Command, ConfigChunk, Request};
use proptest::prelude::*;
use std::path::Path;
use std::sync::OnceLock;

/// Returns periods of a configured, enabled machine at standstill whose host requests its status.
fn standstill_periods() -> &'static [Period] {
    static PERIODS: OnceLock<Vec<Period>> = OnceLock::new();
    PERIODS.get_or_init(|| {
        let machine = MachineFile::built_in().unwrap();
        let mut rig = Rig::new(
            &machine.plant().unwrap(),
            &RigOptions {
                period_us: machine.config.period_us,
                ..RigOptions::default()
            },
            Controller::new(machine.config.period_us),
        )
        .unwrap();
        let mut link = HostLink::new(Timing::default());
        link.open(7, 0);
        let (config, crc) = machine.encoded().unwrap();
        let mut commands: Vec<Command> = config
            .chunks(CONFIG_CHUNK)
            .enumerate()
            .map(|(index, chunk)| {
                Command::Configure(ConfigChunk {
                    offset: (index * CONFIG_CHUNK) as u16,
                    bytes: chunk.iter().copied().collect(),
                })
            })
            .collect();
        commands.push(Command::Activate {
            length: config.len() as u16,
            crc,
            at_preset: false,
        });
        commands.extend([Command::Enable, Command::Telemetry { every: 100 }]);
        let mut commands = (1_u8..).zip(commands).peekable();
        let mut periods = Vec::new();
        for number in 0..4000 {
            let now = rig.time_ns() / 1000;
            if number > 500
                && let Some((id, command)) = commands.peek()
                && link
                    .send(&Request {
                        id: *id,
                        command: command.clone(),
                    })
                    .is_ok()
            {
                commands.next();
            }
            let mut buffer = [0; 256];
            let count = link.transmit(now, &mut buffer);
            rig.host_write(&buffer[..count]);
            rig.step();
            periods.push(Period {
                inputs: rig.inputs().clone(),
                outputs: rig.outputs().clone(),
            });
            let mut received = Vec::new();
            rig.host_read(&mut received);
            link.receive(rig.time_ns() / 1000, &received);
            while link.poll_message().is_some() {}
        }
        assert!(commands.peek().is_none(), "commands were not sent");
        let reading = rig.control().snapshot(rig.inputs()).unwrap();
        assert_eq!(reading.state, haptimill_protocol::message::State::Idle);
        periods
    })
}

/// Records periods.
fn record(path: &Path, periods: &[Period]) -> Recording {
    let mut recorder = Recorder::create(path, &header()).unwrap();
    recorder.start_io_log(IoLog::new());
    for period in periods {
        recorder.period(&period.inputs, &period.outputs);
    }
    recorder.finish().unwrap();
    Recording::open(path).unwrap()
}

#[test]
fn replay_of_a_recording_matches() {
    let file = TemporaryFile::new("replay-equal.hmr");
    let recording = record(&file.0, standstill_periods());
    let equal = replay(&recording).unwrap().unwrap();
    assert_eq!((equal.periods, equal.records), (4000, 0));
}

#[test]
fn changed_input_gives_a_named_difference() {
    let file = TemporaryFile::new("replay-counts.hmr");
    // Two counts of slide l3, once: 2.5 um.
    let mut periods = standstill_periods().to_vec();
    periods[3500].inputs.joints[2].counts ^= 2;
    let recording = record(&file.0, &periods);
    let difference = replay(&recording).unwrap().unwrap_err();
    assert_eq!(difference.period, 3500);
    assert_eq!(difference.field, "the command to drive l3");
    let before = &periods[3500].outputs.joints[2];
    assert_eq!(difference.recorded, format!("{before:?}"));
    assert_ne!(difference.replayed, difference.recorded);
    assert!((difference.time_s - 0.7).abs() < 1e-9);
    let text = difference.to_string();
    assert!(
        text.starts_with("control period 3500 (0.7000 s): the command to drive l3 was Torque("),
        "{text}"
    );
}

#[test]
fn changed_bytes_of_the_line_give_a_difference() {
    let file = TemporaryFile::new("replay-bytes.hmr");
    let mut periods = standstill_periods().to_vec();
    let said = periods
        .iter()
        .rposition(|period| !period.outputs.transmit.is_empty());
    let said = said.unwrap();
    periods[said].outputs.transmit[0] ^= 1;
    let difference = replay(&record(&file.0, &periods)).unwrap().unwrap_err();
    assert_eq!(
        (difference.period, difference.field.as_str()),
        (said as u64, "the bytes sent to the host")
    );

    // A configuration that never came through: the drives stay off.
    let mut periods = standstill_periods().to_vec();
    let received = periods
        .iter()
        .position(|period| period.inputs.received.len() == 64)
        .unwrap();
    periods[received].inputs.received[20] ^= 4;
    let difference = replay(&record(&file.0, &periods)).unwrap().unwrap_err();
    assert!(difference.period >= received as u64, "{difference}");
}

#[test]
fn changed_general_outputs_give_a_named_difference() {
    let file = TemporaryFile::new("replay-outputs.hmr");
    let mut periods = standstill_periods().to_vec();
    periods[3000].outputs.digital ^= 1 << 31;
    let difference = replay(&record(&file.0, &periods)).unwrap().unwrap_err();
    assert_eq!(difference.period, 3000);
    assert_eq!(difference.field, "the digital outputs");
    assert_eq!(difference.recorded, "0x80000000");
    let mut periods = standstill_periods().to_vec();
    periods[3000].outputs.analog[3] = -5;
    let difference = replay(&record(&file.0, &periods)).unwrap().unwrap_err();
    assert_eq!(difference.field, "the analog outputs");
    assert_eq!(difference.recorded, "[0, 0, 0, -5]");
}

#[test]
fn recordings_without_the_first_or_any_periods_are_refused() {
    let file = TemporaryFile::new("replay-late.hmr");
    let error = replay(&record(&file.0, &standstill_periods()[100..])).unwrap_err();
    assert!(
        error
            .to_string()
            .contains("begins at control period 100 of its controller"),
        "{error}"
    );
    let error = replay(&record(&file.0, &[])).unwrap_err();
    assert!(error.to_string().ends_with("has no records"), "{error}");
    let mut recorder = Recorder::create(&file.0, &header()).unwrap();
    recorder.record(&Record::default());
    recorder.finish().unwrap();
    let error = replay(&Recording::open(&file.0).unwrap()).unwrap_err();
    assert!(
        error
            .to_string()
            .contains("has the telemetry of its controller"),
        "{error}"
    );
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, rng_seed: proptest::test_runner::RngSeed::Fixed(6), failure_persistence: None, ..ProptestConfig::default() })]
    /// Impossible inputs never panic, and their replay matches.
    #[test]
    fn impossible_inputs_replay(at in 600_usize..3900, axis in 0_usize..5, counts: i32, edge: u32, missed: u16, garbage in prop::collection::vec(any::<u8>(), 0..64)) {
        let file = TemporaryFile::new("replay-absurd.hmr");
        let mut periods = standstill_periods().to_vec();
        let inputs = &mut periods[at].inputs;
        inputs.joints[axis].counts = counts;
        inputs.joints[axis].edge_time_ns = edge;
        inputs.missed = missed;
        inputs.received = heapless::Vec::from_slice(&garbage).unwrap();
        let mut controller = Controller::new(200);
        let mut outputs = Outputs::default();
        for period in &mut periods {
            outputs.transmit.clear();
            controller.tick(&period.inputs, &mut outputs, &mut ());
            period.outputs = outputs.clone();
        }
        let equal = replay(&record(&file.0, &periods)).unwrap();
        prop_assert_eq!(equal.unwrap().periods, 4000);
    }
}
