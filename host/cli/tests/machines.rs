//! What each machine file of `machines/` can do, shown by doing it, and the table of
//! docs/machines.md.
//!
//! `cargo xtask machines` rewrites the page, `cargo xtask machines FILE` runs one file.

use crate::scene;
use haptimill_client::client::Options;
use haptimill_client::session::{self, Session, SimLine};
use haptimill_firmware::config::PoseAxis;
use haptimill_kinematics::descriptor::{AxisKind, Descriptor, Role};
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::model::Model;
use haptimill_machine_file::scale::per_unit;
use haptimill_protocol::message::{AxisValues, RATE_SHIFT, State};
use haptimill_trace::Recording;
use scene::{TestFolder, haptimill, root};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The page with the table.
const PAGE: &str = "docs/machines.md";

/// Environment variable that rewrites the page.
const WRITE: &str = "HAPTIMILL_WRITE";

/// Environment variable that names the only file of `machines/` to run.
const ONLY: &str = "HAPTIMILL_MACHINE";

/// Columns of the table.
const CAPABILITIES: [&str; 8] = [
    "check",
    "home",
    "run",
    "cut",
    "jog",
    "replay",
    "teleop",
    "force control",
];

/// The whole machines of `machines/`, sorted; the other files are sections to append.
fn files() -> Vec<PathBuf> {
    let entries = std::fs::read_dir(root().join("machines")).expect("a folder");
    let mut files: Vec<PathBuf> = entries
        .map(|entry| entry.expect("an entry").path())
        .filter(|path| {
            let text = std::fs::read_to_string(path).expect("text");
            text.contains("\n[kinematics]")
        })
        .collect();
    files.sort();
    files
}

/// A machine file under test.
struct Machine {
    /// Path from the root.
    file: String,
    machine: MachineFile,
    /// Home pose, mm and degrees.
    home: Vec<f64>,
    folder: TestFolder,
}

/// Result of an attempt: the reason of a refusal, from before anything moved.
type Attempt = Result<(), String>;

impl Machine {
    fn new(path: &Path) -> Self {
        let machine = MachineFile::load(path).unwrap_or_else(|problems| panic!("{problems}"));
        let model = Model::new(&machine);
        let home = model.home(&machine).expect("a home pose");
        let name = path.file_name().and_then(|name| name.to_str());
        Self {
            file: format!("machines/{}", name.expect("a name")),
            home: model.to_engineering_units(&home)[..machine.pose.len()].to_vec(),
            machine,
            folder: TestFolder::new(),
        }
    }

    fn descriptor(&self) -> &'static Descriptor {
        self.machine.config.model.descriptor()
    }

    /// Words of a block: `linear` mm and `rotary` degrees from the home pose in each coordinate.
    fn point(&self, linear: f64, rotary: f64) -> String {
        let axes = self.descriptor().pose.iter().zip(&self.home);
        let axes = axes.zip(&self.machine.config.pose);
        axes.map(|((axis, at), limits)| {
            let by = match axis.kind {
                AxisKind::Linear => linear,
                AxisKind::Rotary | AxisKind::MultiTurn => rotary,
            };
            if limits.wraps() {
                // The sign is the direction.
                let sign = if by < 0.0 { "-" } else { "" };
                return format!(" {}{sign}{:.4}", axis.letter, (at + by).rem_euclid(360.0));
            }
            format!(" {}{:.4}", axis.letter, at + by)
        })
        .collect()
    }

    /// The word of a coordinate with a role, `by` mm from the home pose.
    fn word(&self, role: Role, by: f64) -> Option<String> {
        let axis = self.descriptor().coordinate(role)?;
        let letter = self.descriptor().pose[axis].letter;
        Some(format!("{letter}{:.4}", self.home[axis] + by))
    }

    /// Runs a command with this machine. Refusals have exit codes 2 to 4; other errors are defects.
    fn attempt(&self, command: &[&str]) -> Attempt {
        let ran = haptimill(&[command, &["--machine", &self.file]].concat());
        match ran.code {
            0 => Ok(()),
            2..=4 => Err(ran.err.trim().to_string()),
            _ => panic!("{}: {command:?}: {ran:?}", self.file),
        }
    }

    fn check(&self) -> Attempt {
        haptimill(&["machine", "check", &self.file]).expect_code(0);
        Ok(())
    }

    /// Homes the machine and jogs every coordinate, in virtual time.
    fn home_and_jog(&self) -> [Attempt; 2] {
        let machine = &self.machine;
        let rig = session::rig(machine, None, None, vec![]).expect("a simulated machine");
        let line = SimLine::new(rig);
        let mut session = Session::new(line, machine, Options::default(), Arc::default());
        session.connect(1).expect("a session");
        session.configure(machine).expect("configured");
        session.enable().expect("enabled");
        let home = session::find_home_pose(machine, session.model()).expect("a home pose");
        session.go_home(machine, &home).expect("homed");
        let before = session.status().expect("a status");
        assert!(before.homed, "{}", self.file);
        // 2 mm/s and 2 degrees/s for half a second: downwards, or upwards where the home pose is at
        // the lower soft limit.
        let is_at_low = |index: usize, axis: &PoseAxis| {
            f64::from(before.commanded[index]) - f64::from(axis.low.0) < 2.0 * per_unit(axis.kind)
        };
        let directions: Vec<f64> = (0..)
            .zip(machine.config.pose.iter())
            .map(|(index, axis)| if is_at_low(index, axis) { 1.0 } else { -1.0 })
            .collect();
        let rates: AxisValues = directions
            .iter()
            .zip(machine.config.pose.iter())
            .map(|(direction, axis)| (2.0 * direction * per_unit(axis.kind)) as i32 >> RATE_SHIFT)
            .collect();
        let end = session.now_us() + 500_000;
        let mut next = 0;
        while session.now_us() < end {
            if session.now_us() >= next {
                next = session.now_us() + 50_000;
                session.client_mut().jog(rates.clone(), 200).expect("sent");
            }
            session.step().expect("a session");
            assert_eq!(session.refusal(), None, "{}", self.file);
        }
        let ticket = session.client_mut().cancel_jog();
        session.wait_for_acknowledgement(ticket).expect("cancelled");
        while session.status().expect("a status").state == State::Jog {}
        let after = session.status().expect("a status");
        assert_eq!(after.state, State::Idle, "{}", self.file);
        for (index, axis) in machine.config.pose.iter().enumerate() {
            let moved = f64::from(after.measured[index] - before.measured[index]);
            let moved = directions[index] * moved / per_unit(axis.kind);
            assert!(
                (0.4..1.6).contains(&moved),
                "{}: axis {index} by {moved}",
                self.file
            );
        }
        [Ok(()), Ok(())]
    }

    /// A program that moves every coordinate.
    fn program(&self) -> String {
        let text = format!(
            "G21 G90 G17 F200\nG1{}\nG1{}\nM30\n",
            self.point(-5.0, -3.0),
            self.point(0.0, 0.0)
        );
        self.folder.file("move.ngc", text)
    }

    fn run(&self) -> Attempt {
        let (program, out) = (self.program(), self.folder.path("run"));
        self.attempt(&["run", &program, "--out", &out])?;
        let summary = self.folder.summary("run");
        assert_eq!(summary["completed"], true, "{}: {summary:#}", self.file);
        Ok(())
    }

    fn replay(&self) -> Attempt {
        let recording = self.folder.path("run/recording.hmr");
        haptimill(&["replay", &recording]).expect_code(0);
        Ok(())
    }

    /// A block 2 mm below the home pose; none on a machine without a height of the tool.
    fn stock(&self) -> Option<String> {
        let z = self.descriptor().coordinate(Role::ToolZ)?;
        let top = self.home[z] - 2.0;
        let text = format!(
            "top_mm = {top:.3}\nbottom_mm = {:.3}\n\
             stock = {{ x_min = -60.0, x_max = 60.0, y_min = -60.0, y_max = 60.0 }}\n\
             map = {{ x_min = -30.0, x_max = 30.0, y_min = -20.0, y_max = 20.0 }}\n\
             cell_mm = 0.1\n",
            top - 20.0
        );
        Some(self.folder.file("stock.toml", text))
    }

    /// A groove, 1 mm deep; none on a machine whose tool does not move along x and z.
    fn groove(&self) -> Option<String> {
        let (z, x) = (Role::ToolZ, Role::ToolX);
        let text = format!(
            "G21 G90 S6000 M3\nG4 P1\nG1 {} F120\nG1 {} F200\nG1 {} F200\nM5\nM30\n",
            self.word(z, -3.0)?,
            self.word(x, -10.0)?,
            self.word(z, 0.0)?
        );
        Some(self.folder.file("groove.ngc", text))
    }

    /// Largest force on the simulated tool in a recording, N.
    fn largest_force(&self, out: &str) -> f64 {
        let path = self.folder.path(&format!("{out}/recording.hmr"));
        let recording = Recording::open(Path::new(&path)).expect("readable");
        let records = recording.iter().expect("readable");
        records
            .flat_map(|record| record.expect("readable").true_force)
            .map(|force| (f64::from(force) / 65_536.0).abs())
            .fold(0.0, f64::max)
    }

    fn cut(&self) -> Attempt {
        let (Some(program), Some(stock)) = (self.groove(), self.stock()) else {
            return Err("no coordinates have the roles tool x and tool z".to_string());
        };
        let out = self.folder.path("cut");
        self.attempt(&["run", &program, "--stock", &stock, "--out", &out])?;
        assert!(self.largest_force("cut") > 0.5, "{}", self.file);
        Ok(())
    }

    fn teleop(&self) -> Attempt {
        let script = "[[button]]\nat_s = 0.5\nheld = true\n\n[[stroke]]\nat_s = 1.0\n\
                      to_mm = [-5.0, 0.0, 0.0]\npace_mm_s = 5.0\nramp_s = 0.3\n\n\
                      [[button]]\nat_s = 2.5\nheld = false\n";
        let script = format!("script:{}", self.folder.file("script.toml", script));
        let out = self.folder.path("teleop");
        self.attempt(&["teleop", "--master", &script, "--out", &out])?;
        let path = self.folder.path("teleop/recording.hmr");
        let recording = Recording::open(Path::new(&path)).expect("readable");
        let x = self.descriptor().coordinate(Role::ToolX).expect("a tool");
        let records = recording.iter().expect("readable");
        let places: Vec<i32> = records
            .map(|record| record.expect("readable").tool[x])
            .collect();
        let span = places.iter().max().expect("one") - places.iter().min().expect("one");
        let span = f64::from(span) / per_unit(AxisKind::Linear);
        assert!(span > 2.0, "{}: the tool moved {span} mm", self.file);
        Ok(())
    }

    /// Whether the machine file has a force sensor.
    fn has_sensor(&self) -> bool {
        self.machine.text.contains("\n[force.sensor]")
    }

    /// The machine file; one without a force sensor gets that of `h4.toml`.
    fn file_with_sensor(&self) -> String {
        if self.has_sensor() {
            return self.file.clone();
        }
        let h4 = std::fs::read_to_string(root().join("machines/h4.toml")).expect("text");
        let part = |from: &str, to: &str| {
            let (_, rest) = h4.split_once(from).expect(from);
            let (part, _) = rest.split_once(to).expect(to);
            format!("\n{}{part}", from.trim_start())
        };
        let force = part("\n[force]\n", "\n[plant]\n");
        let sensor = part("\n[plant.sensor]\n", "\n[[plant.joint]]\n");
        let text = format!("{}{force}{sensor}", self.machine.text);
        self.folder.file("with-sensor.toml", text)
    }

    fn force_control(&self) -> Attempt {
        let program = self.groove().unwrap_or_else(|| self.program());
        let (file, out) = (self.file_with_sensor(), self.folder.path("force"));
        let mut command = vec!["run", &program, "--machine", &file, "--out", &out];
        let stock = self.stock();
        if let Some(stock) = &stock {
            command.extend(["--stock", stock]);
        }
        command.extend(["--force", "x", "--force-setpoint", "1"]);
        let ran = haptimill(&command);
        match ran.code {
            0 => (),
            2..=4 => return Err(ran.err.trim().to_string()),
            _ => panic!("{}: {ran:?}", self.file),
        }
        let path = self.folder.path("force/recording.hmr");
        let recording = Recording::open(Path::new(&path)).expect("readable");
        let mut records = recording.iter().expect("readable");
        let is_displaced =
            records.any(|record| record.expect("readable").force.displacement[0] != 0);
        assert!(is_displaced, "{}: the tool did not comply", self.file);
        Ok(())
    }

    /// All attempts, in the order of [`CAPABILITIES`].
    fn attempts(&self) -> [Attempt; 8] {
        let [home, jog] = self.home_and_jog();
        [
            self.check(),
            home,
            self.run(),
            self.cut(),
            jog,
            self.replay(),
            self.teleop(),
            self.force_control(),
        ]
    }

    /// A refusal without paths and lines of files.
    fn reason(&self, text: &str) -> String {
        let line = text.lines().next().unwrap_or_default();
        let line = self.folder.redact(line).replace("DIR/", "");
        let at = line.find(": ").map_or(0, |at| at + 2);
        let (file, rest) = line.split_at(at);
        if file.contains(".toml") {
            rest.to_string()
        } else {
            line
        }
    }
}

#[test]
fn every_machine_does_what_its_page_says() {
    let mut table = format!("| file | model | {} |\n", CAPABILITIES.join(" | "));
    table.push_str(&"| --- ".repeat(CAPABILITIES.len() + 2));
    table.push_str("|\n");
    let mut reasons = Vec::new();
    let only = std::env::var(ONLY).ok();
    let mut files = files();
    if let Some(name) = &only {
        files.retain(|file| file.file_name().is_some_and(|file| file == name.as_str()));
        assert_eq!(files.len(), 1, "machines/{name} is not there");
    }
    for path in files {
        let machine = Machine::new(&path);
        let code = machine.descriptor().code;
        let mut cells = Vec::new();
        for (attempt, what) in machine.attempts().iter().zip(CAPABILITIES) {
            println!("{}: {what}: {attempt:?}", machine.file);
            match attempt {
                Ok(()) if what == "force control" && !machine.has_sensor() => {
                    cells.push("yes, sensor added".to_string());
                }
                Ok(()) => cells.push("yes".to_string()),
                Err(text) => {
                    // Nothing moved: there is no recording.
                    for out in ["teleop", "force"] {
                        let is_refused = what.starts_with(out);
                        let recording = machine.folder.path(&format!("{out}/recording.hmr"));
                        assert!(!is_refused || !Path::new(&recording).exists(), "{what}");
                    }
                    assert!(
                        text.len() > 20,
                        "{}: {what}: no sentence: {text}",
                        machine.file
                    );
                    let reason = machine.reason(text);
                    let place = reasons.iter().position(|known| *known == reason);
                    let place = place.unwrap_or_else(|| {
                        reasons.push(reason);
                        reasons.len() - 1
                    });
                    cells.push(format!("refused ({})", place + 1));
                }
            }
        }
        let file = machine.file.trim_start_matches("machines/");
        table.push_str(&format!("| `{file}` | {code} | {} |\n", cells.join(" | ")));
    }
    if !reasons.is_empty() {
        table.push_str("\nRefused before anything moves:\n\n| | message |\n| --- | --- |\n");
        for (index, reason) in reasons.iter().enumerate() {
            table.push_str(&format!("| {} | {reason} |\n", index + 1));
        }
    }
    if only.is_some() {
        return;
    }
    let page = root().join(PAGE);
    let text = std::fs::read_to_string(&page).expect("the page");
    let mark = "<!-- written by `cargo xtask machines` -->\n";
    let (head, _) = text.split_once(mark).expect("the mark");
    let new = format!("{head}{mark}\n{table}");
    if std::env::var_os(WRITE).is_some() {
        std::fs::write(&page, new).expect("written");
    } else {
        assert_eq!(
            text, new,
            "{PAGE} is not what was shown; run `cargo xtask machines`"
        );
    }
}
