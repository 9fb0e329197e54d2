//! Time of the wire format: setpoints encoded and decoded, frames encoded and decoded, a message
//! and its answer.
#![allow(
    missing_docs,
    reason = "the benchmark's macros make functions without any"
)]

use criterion::{BatchSize, Criterion, Throughput, criterion_group, criterion_main};
use haptimill_protocol::frame::{self, Acknowledgement, FrameBytes, FrameDecoder, Header};
use haptimill_protocol::link::{ControllerLink, HostLink, Identity, LinkState, Timing};
use haptimill_protocol::message::{Action, AxisValues, Command, Report, Request, SetpointDelta};
use haptimill_protocol::setpoint::{Setpoint, SetpointCoder};
use std::hint::black_box;

/// A smooth path of five axes, 20 ms per setpoint (100 periods of 200 us).
fn path(count: usize) -> (AxisValues, Vec<Setpoint>) {
    let at = |t: f64| -> Vec<(f64, f64)> {
        (1..=5)
            .map(|k| {
                let w = 0.1 * f64::from(k);
                ((w * t).sin() * 2e7, w * (w * t).cos() * 2e7 / 256.0)
            })
            .collect()
    };
    let setpoints = (0..=count)
        .map(|n| {
            let values = at(n as f64 * 0.02);
            Setpoint {
                periods: 100,
                pose: values.iter().map(|v| v.0.round() as i32).collect(),
                rates: values.iter().map(|v| v.1.round() as i32).collect(),
                action: Action::None,
            }
        })
        .collect::<Vec<_>>();
    (setpoints[0].pose.clone(), setpoints[1..].to_vec())
}

fn setpoints(c: &mut Criterion) {
    let (start, setpoints) = path(1000);
    let mut coder = SetpointCoder::new(200, &start);
    let deltas: Vec<SetpointDelta> = setpoints
        .iter()
        .map(|s| coder.encode(s).expect("a good setpoint"))
        .collect();
    let mut group = c.benchmark_group("setpoint");
    group.throughput(Throughput::Elements(1000));
    group.bench_function("decode 5 axes", |b| {
        b.iter(|| {
            let mut coder = SetpointCoder::new(200, &start);
            for delta in &deltas {
                black_box(coder.decode(black_box(delta)).expect("a good delta"));
            }
        });
    });
    group.bench_function("encode 5 axes", |b| {
        b.iter(|| {
            let mut coder = SetpointCoder::new(200, &start);
            for setpoint in &setpoints {
                black_box(coder.encode(black_box(setpoint)).expect("a good setpoint"));
            }
        });
    });
    let bytes: Vec<Vec<u8>> = deltas
        .iter()
        .map(|delta| {
            let mut buffer = [0; 80];
            postcard::to_slice(delta, &mut buffer)
                .expect("room")
                .to_vec()
        })
        .collect();
    group.bench_function("bytes to setpoint, 5 axes", |b| {
        b.iter(|| {
            let mut coder = SetpointCoder::new(200, &start);
            for bytes in &bytes {
                let delta: SetpointDelta =
                    postcard::from_bytes(black_box(bytes)).expect("a good delta");
                black_box(coder.decode(&delta).expect("a good delta"));
            }
        });
    });
    group.finish();
}

fn frames(c: &mut Criterion) {
    let payload: Vec<u8> = (0..64u8).map(|k| k.wrapping_mul(37)).collect();
    let acknowledgement = Acknowledgement { next: 3, beyond: 0 };
    let header = Header::Reliable {
        sequence: 9,
        acknowledgement,
    };
    let mut bytes = FrameBytes::new();
    frame::encode(header, &payload, 5, &mut bytes).expect("it fits");
    let mut group = c.benchmark_group("frame of 64 bytes");
    group.throughput(Throughput::Bytes(bytes.len() as u64));
    group.bench_function("encode", |b| {
        let mut out = FrameBytes::new();
        b.iter(|| frame::encode(black_box(header), black_box(&payload), 5, &mut out));
    });
    group.bench_function("decode", |b| {
        let mut decoder = FrameDecoder::new();
        decoder.set_session(5);
        b.iter(|| {
            black_box(&bytes)
                .iter()
                .filter(|&&byte| decoder.push(byte).is_some())
                .count()
        });
    });
    group.finish();
}

fn link(c: &mut Criterion) {
    let timing = Timing {
        acknowledge_us: 0,
        ..Timing::default()
    };
    let open = || {
        let (mut host, mut controller, mut buffer) =
            (HostLink::new(timing), ControllerLink::new(timing), [0; 512]);
        host.open(7, 0);
        let identity = Identity {
            machine: "bench",
            config_crc: 0,
            period_us: 200,
            axes: 5,
            queue: 64,
            kept: haptimill_protocol::message::Kept::Unsupported,
        };
        let count = host.transmit(0, &mut buffer);
        controller.receive(0, &buffer[..count]);
        controller.welcome(0, &identity, false);
        let count = controller.transmit(0, &mut buffer);
        host.receive(0, &buffer[..count]);
        assert_eq!(host.state(0), LinkState::Open);
        (host, controller)
    };
    c.bench_function("link: 100 requests and answers", |b| {
        b.iter_batched_ref(
            open,
            |(host, controller)| {
                let mut buffer = [0; 512];
                for now_us in 1..=100 {
                    host.send(&Request {
                        id: 1,
                        command: Command::Ping,
                    })
                    .expect("room");
                    let count = host.transmit(now_us, &mut buffer);
                    controller.receive(now_us, &buffer[..count]);
                    let request = controller.poll_message().expect("a request");
                    controller
                        .send(&Report::Answer {
                            id: request.id,
                            result: Ok(()),
                        })
                        .expect("room");
                    let count = controller.transmit(now_us, &mut buffer);
                    host.receive(now_us, &buffer[..count]);
                    black_box(host.poll_message().expect("an answer"));
                }
            },
            BatchSize::SmallInput,
        );
    });
}

criterion_group!(benches, setpoints, frames, link);
criterion_main!(benches);
