//! A recorded machine in this process, and a cable that can be disconnected.

use haptimill_client::port::{TcpServer, Transport};
use haptimill_client::session;
use haptimill_machine_file::MachineFile;
use haptimill_protocol::message::State;
use std::io::{Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// State of the machine at one time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    pub at: Instant,
    pub state: State,
    /// x of the commanded pose, mm.
    pub commanded: f64,
    /// True x of the tool, mm.
    pub tool: f64,
}

/// The simulated machine with its controller, on a TCP port like `sim serve`.
pub struct Machine {
    pub port: String,
    samples: Arc<Mutex<Vec<Sample>>>,
    end: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Machine {
    pub fn start() -> Self {
        let mut server = TcpServer::listen("127.0.0.1:0").unwrap();
        let port = server.name().to_string();
        let samples: Arc<Mutex<Vec<Sample>>> = Arc::default();
        let end = Arc::new(AtomicBool::new(false));
        let thread = {
            let (samples, end) = (Arc::clone(&samples), Arc::clone(&end));
            std::thread::spawn(move || run(&mut server, &samples, &end))
        };
        Self {
            port,
            samples,
            end,
            thread: Some(thread),
        }
    }

    /// Latest sample.
    pub fn now(&self) -> Sample {
        loop {
            if let Some(samples) = self.samples.lock().unwrap().last() {
                return *samples;
            }
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    /// Drops all samples but the latest.
    pub fn clear_samples(&self) {
        let mut samples = self.samples.lock().unwrap();
        let last = samples.pop();
        samples.clear();
        samples.extend(last);
    }

    /// All samples since the last call of `clear_samples`.
    pub fn samples(&self) -> Vec<Sample> {
        self.samples.lock().unwrap().clone()
    }

    /// Waits until the machine is in a state.
    #[track_caller]
    pub fn wait_for_state(&self, state: State) {
        let started = Instant::now();
        while self.now().state != state {
            assert!(
                started.elapsed() < super::terminal::TIMEOUT,
                "timeout: state {state}, now {:?}",
                self.now()
            );
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    /// Waits until the commanded pose is constant for this time.
    pub fn wait_for_standstill(&self, time: Duration) {
        loop {
            let before = self.now().commanded;
            std::thread::sleep(time);
            if self.now().commanded == before && self.now().state != State::Jog {
                return;
            }
        }
    }
}

impl Drop for Machine {
    fn drop(&mut self) {
        self.end.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

fn run(server: &mut TcpServer, samples: &Mutex<Vec<Sample>>, end: &AtomicBool) {
    let file = MachineFile::built_in().unwrap();
    let rig = session::rig(&file, None, None, Vec::new()).unwrap();
    let Ok(mut rig) = session::commissioned(rig, &file) else {
        panic!("configuration refused");
    };
    let period_ns = u64::from(file.config.period_us) * 1000;
    let started = Instant::now();
    let mut skipped = 0;
    let (mut buffer, mut output) = ([0; 4096], Vec::new());
    while !end.load(Ordering::Relaxed) {
        let real = started.elapsed().as_nanos() as u64;
        let mut behind = real.saturating_sub(rig.time_ns() + skipped);
        if behind > 20_000_000 {
            skipped += behind - 20_000_000;
            behind = 20_000_000;
        }
        for _ in 0..behind / period_ns {
            rig.step();
        }
        if let Some(snapshot) = rig.control().snapshot(rig.inputs()) {
            let now = Sample {
                at: Instant::now(),
                state: snapshot.state,
                commanded: f64::from(snapshot.commanded[0]) / f64::from(1 << 20),
                tool: rig.truth().pose[0],
            };
            let mut samples = samples.lock().unwrap();
            let is_new = samples.last().is_none_or(|last| {
                last.state != now.state
                    || last.commanded != now.commanded
                    || (last.tool - now.tool).abs() > 5e-4
            });
            if is_new {
                samples.push(now);
            }
        }
        rig.host_read(&mut output);
        let taken = server.write(&output, Duration::ZERO).unwrap();
        output.drain(..taken);
        let count = server
            .read(&mut buffer, Duration::from_micros(200))
            .unwrap();
        rig.host_write(&buffer[..count]);
    }
}

/// A cable between a host and a served machine.
pub struct Cable {
    /// Value of --port for the host.
    pub port: String,
    connected: Arc<AtomicBool>,
    streams: Arc<Mutex<Vec<TcpStream>>>,
    /// First bytes from the host on the newest connection.
    first: Arc<Mutex<Vec<u8>>>,
}

impl Cable {
    /// A cable to the machine at `tcp:HOST:PORT`.
    pub fn to(machine: &str) -> Self {
        let machine = machine.strip_prefix("tcp:").unwrap().to_string();
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = format!("tcp:{}", listener.local_addr().unwrap());
        let connected = Arc::new(AtomicBool::new(true));
        let streams: Arc<Mutex<Vec<TcpStream>>> = Arc::default();
        let first: Arc<Mutex<Vec<u8>>> = Arc::default();
        let cable = Self {
            port,
            connected: Arc::clone(&connected),
            streams: Arc::clone(&streams),
            first: Arc::clone(&first),
        };
        std::thread::spawn(move || {
            for host in listener.incoming().flatten() {
                if !connected.load(Ordering::SeqCst) {
                    continue;
                }
                let Ok(there) = TcpStream::connect(&machine) else {
                    continue;
                };
                first.lock().unwrap().clear();
                let mut streams = streams.lock().unwrap();
                streams.push(host.try_clone().unwrap());
                streams.push(there.try_clone().unwrap());
                drop(streams);
                let (host_reads, there_reads) =
                    (host.try_clone().unwrap(), there.try_clone().unwrap());
                let first = Arc::clone(&first);
                std::thread::spawn(move || forward(host_reads, there, Some(&first)));
                std::thread::spawn(move || forward(there_reads, host, None));
            }
        });
        cable
    }

    pub fn disconnect(&self) {
        self.connected.store(false, Ordering::SeqCst);
        for stream in self.streams.lock().unwrap().drain(..) {
            let _ = stream.shutdown(Shutdown::Both);
        }
    }

    pub fn reconnect(&self) {
        self.connected.store(true, Ordering::SeqCst);
    }

    /// First bytes from the host since the reconnection.
    pub fn first(&self, count: usize) -> Vec<u8> {
        let first = self.first.lock().unwrap();
        first[..count.min(first.len())].to_vec()
    }
}

fn forward(mut from: TcpStream, mut to: TcpStream, first: Option<&Mutex<Vec<u8>>>) {
    let _ = from.set_nodelay(true);
    let _ = to.set_nodelay(true);
    let mut buffer = [0; 4096];
    while let Ok(count @ 1..) = from.read(&mut buffer) {
        if let Some(first) = first {
            let mut first = first.lock().unwrap();
            if first.len() < 64 {
                first.extend_from_slice(&buffer[..count]);
            }
        }
        if to.write_all(&buffer[..count]).is_err() {
            break;
        }
    }
    let _ = from.shutdown(Shutdown::Both);
    let _ = to.shutdown(Shutdown::Both);
}
