//! Arbitrary bytes into the decoder, the messages, the setpoints and both endpoints of a link.
//!
//! Under `cargo test` each target replays its corpus (`__fuzz__/NAME/corpus`) and then runs on
//! random input for a bounded number of rounds. A failure prints the seed that repeats it. `cargo
//! bolero test NAME` runs the same targets under a fuzzer. `cargo test --test fuzz -- --ignored
//! write_corpus` writes the corpus anew.

use haptimill_protocol::frame::{self, Acknowledgement, FrameBytes, FrameDecoder, Header};
use haptimill_protocol::link::{
    ControllerLink, HelloOutcome, HostLink, Identity, LinkState, Timing,
};
use haptimill_protocol::message::{
    Action, Command, ConfigChunk, Event, Hello, PROTOCOL_VERSION, Report, Request, SetpointBatch,
    State,
};
use haptimill_protocol::out_of_band;
use haptimill_protocol::schema::schema_hash;
use haptimill_protocol::setpoint::{Setpoint, SetpointCoder};

/// Session of the frames in the corpus.
const THEIRS: u32 = 7;
/// Session of the links.
const OURS: u32 = 8;
const ROUNDS: usize = 20_000;
const IDENTITY: Identity<'static> = Identity {
    machine: "fuzz",
    config_crc: 0,
    period_us: 200,
    axes: 5,
    queue: 64,
    kept: haptimill_protocol::message::Kept::Unsupported,
};

/// Runs a body on the corpus and on short inputs, then on long ones (the engine's own byte strings
/// have 64 bytes at most).
macro_rules! throw {
    ($body:expr) => {{
        let body: fn(&[u8]) = $body;
        bolero::check!().with_iterations(ROUNDS).for_each(body);
        let long = bolero::produce::<Vec<u8>>().with().len(0usize..1500);
        bolero::check!()
            .with_generator(long)
            .with_max_len(4096)
            .with_iterations(ROUNDS / 10)
            .for_each(|input: &Vec<u8>| body(input));
    }};
}

/// Both endpoints, in a session.
fn pair() -> (HostLink, ControllerLink) {
    let (mut host, mut controller) = (
        HostLink::new(Timing::default()),
        ControllerLink::new(Timing::default()),
    );
    let mut buffer = [0; 512];
    host.open(OURS, 0);
    let count = host.transmit(0, &mut buffer);
    controller.receive(0, &buffer[..count]);
    assert_eq!(controller.welcome(0, &IDENTITY, false), HelloOutcome::Begun);
    let count = controller.transmit(0, &mut buffer);
    host.receive(0, &buffer[..count]);
    assert_eq!(host.state(0), LinkState::Open);
    (host, controller)
}

/// An accepted frame is, byte for byte, the encoding of its content, and the decoder is
/// synchronised after the next zero.
#[test]
fn frame_decoder() {
    throw!(|input: &[u8]| {
        let mut decoder = FrameDecoder::new();
        decoder.set_session(THEIRS);
        let mut start = 0;
        for (end, &byte) in input.iter().enumerate() {
            if let Some(found) = decoder.push(byte) {
                let mut again = FrameBytes::new();
                frame::encode(found.header, found.payload, THEIRS, &mut again).expect("it fitted");
                // COBS permits a stray code of one (01) at the very end.
                let line = &input[start..=end];
                assert!(
                    line == &again[..] || line.len() == again.len() + 1,
                    "{line:?} {again:?}"
                );
            }
            if byte == 0 {
                start = end + 1;
            }
        }
        decoder.push(0);
        let mut good = FrameBytes::new();
        frame::encode(
            Header::Acknowledge(Acknowledgement { next: 1, beyond: 2 }),
            &[],
            THEIRS,
            &mut good,
        )
        .expect("it fits");
        assert_eq!(
            good.iter()
                .filter(|&&byte| decoder.push(byte).is_some())
                .count(),
            1
        );
    });
}

/// A message that can be decoded can be encoded, and decodes to the same value. Setpoints are
/// decoded or refused.
#[test]
fn messages() {
    throw!(|input: &[u8]| {
        let mut buffer = [0; 1024];
        if let Ok(request) = postcard::from_bytes::<Request>(input) {
            let bytes = postcard::to_slice(&request, &mut buffer).expect("room");
            assert_eq!(
                postcard::from_bytes::<Request>(bytes).as_ref(),
                Ok(&request)
            );
            if let Command::Setpoints(batch) = request.command {
                let mut coder = SetpointCoder::new(200, &[0; 5].into_iter().collect());
                for delta in &batch.items {
                    let _ = coder.decode(delta);
                }
            }
        }
        if let Ok(report) = postcard::from_bytes::<Report>(input) {
            let bytes = postcard::to_slice(&report, &mut buffer).expect("room");
            assert_eq!(postcard::from_bytes::<Report>(bytes).as_ref(), Ok(&report));
        }
    });
}

/// Bytes of another session, whole or broken, give no message at either endpoint, and later
/// messages arrive as before.
#[test]
fn link_ends() {
    throw!(|input: &[u8]| {
        let (mut host, mut controller) = pair();
        let mut now_us = 1;
        for piece in input.chunks(48) {
            controller.receive(now_us, piece);
            host.receive(now_us, piece);
            now_us += 200;
            assert_eq!(controller.poll_message(), None);
            assert_eq!(host.poll_message(), None);
        }
        // A `Hello` among the bytes would be a new session, which a busy controller refuses.
        let _ = controller.welcome(now_us, &IDENTITY, true);
        assert_eq!((host.session(), controller.session()), (OURS, OURS));
        let request = Request {
            id: 3,
            command: Command::Hold,
        };
        let mut buffer = [0; 512];
        host.send(&request).expect("open");
        let mut received = None;
        // The first frame may be joined to earlier bytes; then it is sent again.
        for _ in 0..200 {
            now_us += 1000;
            let count = host.transmit(now_us, &mut buffer);
            controller.receive(now_us, &buffer[..count]);
            received = received.or(controller.poll_message());
        }
        assert_eq!(received, Some(request));
    });
}

/// Frames and messages as on the line, whole and with typical errors.
#[test]
#[ignore = "writes files"]
fn write_corpus() {
    let acknowledgement = Acknowledgement {
        next: 4,
        beyond: 0b101,
    };
    let mut coder = SetpointCoder::new(200, &[0; 5].into_iter().collect());
    let items = (1..=4)
        .map(|k| {
            let setpoint = Setpoint {
                periods: 100,
                pose: [k * k * 100, -k * 5000, 0, i32::MAX, 7]
                    .into_iter()
                    .collect(),
                rates: [k * 3, 0, 0, -k, 9].into_iter().collect(),
                action: if k == 2 {
                    Action::Spindle(9000)
                } else {
                    Action::None
                },
            };
            coder.encode(&setpoint).expect("a good setpoint")
        })
        .collect();
    let requests = [
        Command::Setpoints(SetpointBatch { first: 1000, items }),
        Command::Configure(ConfigChunk {
            offset: 64,
            bytes: [0; 64].into_iter().collect(),
        }),
        Command::JobStart {
            job: 9,
            pose: [1, -1, 0, i32::MIN, i32::MAX].into_iter().collect(),
        },
        Command::Jog {
            epoch: 3,
            timeout_ms: 200,
            rates: [0, 4096].into_iter().collect(),
        },
        Command::EmergencyStop,
    ];
    let event = Event::State {
        from: State::Run,
        to: State::Hold,
        homed: true,
    };
    let hello = Hello {
        version: PROTOCOL_VERSION,
        schema: schema_hash(),
        session: THEIRS,
    };
    let mut payloads: Vec<(Header, Vec<u8>)> = Vec::new();
    let mut buffer = [0; 512];
    for (sequence, command) in requests.into_iter().enumerate() {
        let bytes = postcard::to_slice(&Request { id: 1, command }, &mut buffer)
            .expect("room")
            .to_vec();
        payloads.push((
            Header::Reliable {
                sequence: sequence as u8,
                acknowledgement,
            },
            bytes,
        ));
    }
    let bytes = postcard::to_slice(
        &Report::Event {
            period: 1 << 40,
            event,
        },
        &mut buffer,
    )
    .expect("room")
    .to_vec();
    payloads.push((
        Header::Latest {
            sequence: 1,
            acknowledgement,
        },
        bytes,
    ));
    let bytes = postcard::to_slice(&hello, &mut buffer)
        .expect("room")
        .to_vec();
    payloads.push((Header::Hello, bytes));
    payloads.push((Header::Acknowledge(acknowledgement), Vec::new()));

    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/__fuzz__");
    let write = |target: &str, name: String, bytes: &[u8]| {
        let folder = folder.join(target).join("corpus");
        std::fs::create_dir_all(&folder).expect("a folder");
        std::fs::write(folder.join(name), bytes).expect("a file");
    };
    let mut stream = Vec::new();
    for (index, (header, payload)) in payloads.iter().enumerate() {
        write("messages", format!("payload-{index}"), payload);
        let mut line = FrameBytes::new();
        frame::encode(*header, payload, THEIRS, &mut line).expect("it fits");
        stream.extend_from_slice(&line);
        for target in ["frame_decoder", "link_ends"] {
            write(target, format!("frame-{index}"), &line);
            write(target, format!("cut-{index}"), &line[..line.len() / 2]);
            let mut broken = line.clone();
            broken[index] ^= 0x10;
            write(target, format!("bit-{index}"), &broken);
        }
    }
    let doubled = [&stream[..], &out_of_band::STOP, &stream[3..]].concat();
    for target in ["frame_decoder", "link_ends"] {
        write(target, "stream".into(), &stream);
        write(target, "stop-and-shifted-stream".into(), &doubled);
    }
}
