//! `haptimill probe edge`, `bore`, `boss` and `tool`: probing cycles.

mod args;
mod origin;
mod prober;

pub use args::{BoreArgs, BossArgs, CycleArgs, EdgeArgs, ProbeCycle, ToolArgs, ZeroArgs};
pub(crate) use origin::{kept_beside, set_origin};

use super::board::file_of;
use super::jog::check_feed;
use super::probing::{Touch, find_input};
use super::simple::open;
use super::{CliError, Exit, output};
use haptimill_client::session::check_has_tool;
use haptimill_kinematics::descriptor::Role;
use haptimill_machine_file::model;
use haptimill_machine_file::work_data::{WorkData, offsets_path, tools_path};
use origin::{find_system, settable_system};
use prober::Prober;
use std::path::PathBuf;

/// Least part of a direction along Z, less than 1 by this, that measures a length to 1e-6 of it.
const ALONG_Z: f64 = 1e-6;

/// Runs a probing cycle.
///
/// # Errors
/// See [`Exit`].
pub fn run(command: &ProbeCycle) -> Result<(), CliError> {
    let shared = command.shared();
    check(command)?;
    let chosen = shared.machine.load()?;
    let mut session = open(&shared.connect, &chosen.file)?;
    let machine = file_of(&chosen, &mut session)?;
    check_has_tool(&machine)?;
    let touch = match command {
        ProbeCycle::Tool(_) => Touch::ToolSetter,
        _ => Touch::Probe,
    };
    let input = find_input(&machine, shared.input.as_deref(), touch)?;
    // A file that cannot be written is known before the machine moves.
    let file = match command.zero() {
        Some(ZeroArgs { set: None, .. }) => None,
        _ => Some(kept_beside(&machine)?),
    };
    if let Some(file) = &file {
        let path = match command.zero().and_then(|zero| zero.set.as_deref()) {
            Some(system) => {
                settable_system(file, system)?;
                offsets_path(file)
            }
            None => tools_path(file),
        };
        output::check_writable(&path)?;
    }
    let mut prober = Prober {
        session,
        machine,
        input,
        shared,
    };
    match command {
        ProbeCycle::Edge(args) => prober.edge(args, file),
        ProbeCycle::Bore(args) => {
            let found = prober.bore(args.reach)?;
            prober.report_centre(found, args.radius, &args.zero, file)
        }
        ProbeCycle::Boss(args) => {
            let found = prober.boss(args)?;
            prober.report_centre(found, -args.radius, &args.zero, file)
        }
        ProbeCycle::Tool(args) => prober.tool(args, file),
    }
}

/// Refuses values that no cycle can use.
fn check(command: &ProbeCycle) -> Result<(), CliError> {
    let shared = command.shared();
    check_feed(shared.feed)?;
    check_feed(shared.search_feed)?;
    let lengths = match command {
        ProbeCycle::Edge(args) => vec![("--radius", args.radius, 0.0)],
        ProbeCycle::Bore(args) => {
            vec![
                ("--reach", args.reach, 1e-3),
                ("--radius", args.radius, 0.0),
            ]
        }
        ProbeCycle::Boss(args) => vec![
            ("--depth", args.depth, 1e-3),
            ("--clearance", args.clearance, 1e-3),
            ("--radius", args.radius, 0.0),
        ],
        ProbeCycle::Tool(args) => vec![
            ("--reach", args.reach, 1e-3),
            ("--diameter", args.diameter.unwrap_or(0.0), 0.0),
        ],
    };
    if let Some(system) = command.zero().and_then(|zero| zero.set.as_deref()) {
        find_system(system)?;
    }
    let back_off = ("--back-off", shared.back_off, 1e-3);
    for (name, value, min) in lengths.into_iter().chain([back_off]) {
        if !(min..=1e4).contains(&value) {
            let what = format!("{name} {value}: write {min} to 10000 mm");
            return Err(CliError::new(Exit::Usage, what));
        }
    }
    Ok(())
}

/// The centre between two pairs of walls, and their distances between the contacts.
struct Centre {
    at: [f64; 2],
    across: [f64; 2],
}

impl Prober<'_> {
    fn edge(&mut self, args: &EdgeArgs, file: Option<PathBuf>) -> Result<(), CliError> {
        let axis = self.linear_coordinate(&args.coordinate.coordinate)?;
        let distance = args.coordinate.value;
        if distance == 0.0 {
            let what = format!(
                "{}=0: write the largest distance",
                args.coordinate.coordinate
            );
            return Err(CliError::new(Exit::Usage, what));
        }
        let contact = self.touch(axis, distance)?;
        let edge = contact + distance.signum() * args.radius;
        let name = self.machine.pose[axis].name.clone();
        self.print(
            &[(name.clone(), edge)],
            &format!("edge at  {name} {edge:.4} mm"),
        );
        self.set_zero(&[(axis, edge)], &args.zero, file)
    }

    fn bore(&mut self, reach: f64) -> Result<Centre, CliError> {
        let (x, y) = (self.tool_axis(Role::ToolX)?, self.tool_axis(Role::ToolY)?);
        // The first measurement along x may be of a chord; that along y passes the middle.
        self.walls(x, |it, sign| it.touch(x, sign * reach))?;
        let along_y = self.walls(y, |it, sign| it.touch(y, sign * reach))?;
        let along_x = self.walls(x, |it, sign| it.touch(x, sign * reach))?;
        Ok(Centre {
            at: [along_x.0, along_y.0],
            across: [along_x.1, along_y.1],
        })
    }

    fn boss(&mut self, args: &BossArgs) -> Result<Centre, CliError> {
        let axes = [self.tool_axis(Role::ToolX)?, self.tool_axis(Role::ToolY)?];
        let z = self.tool_axis(Role::ToolZ)?;
        let mut found = [(0.0, 0.0); 2];
        // The second round measures through the middle of the first one.
        for _ in 0..2 {
            for ((axis, size), found) in axes.iter().zip(args.size).zip(&mut found) {
                let out = size / 2.0 + args.clearance;
                *found = self.walls(*axis, |it, sign| {
                    it.touch_beside([*axis, z], sign * out, args.depth)
                })?;
            }
        }
        Ok(Centre {
            at: [found[0].0, found[1].0],
            across: [found[0].1, found[1].1],
        })
    }

    fn report_centre(
        &mut self,
        found: Centre,
        radius: f64,
        zero: &ZeroArgs,
        file: Option<PathBuf>,
    ) -> Result<(), CliError> {
        let [x, y] = found.at;
        let [across_x, across_y] = found.across.map(|across| across + 2.0 * radius);
        let values = [
            ("x", x),
            ("y", y),
            ("size_x", across_x),
            ("size_y", across_y),
        ]
        .map(|(name, value)| (name.to_string(), value));
        let text = format!(
            "centre at  x {x:.4} mm  y {y:.4} mm, size  x {across_x:.4} mm  y {across_y:.4} mm"
        );
        self.print(&values, &text);
        let axes = [self.tool_axis(Role::ToolX)?, self.tool_axis(Role::ToolY)?];
        self.set_zero(&[(axes[0], x), (axes[1], y)], zero, file)
    }

    fn print(&self, values: &[(String, f64)], text: &str) {
        if self.shared.json {
            let values = values
                .iter()
                .map(|(name, value)| (name.clone(), serde_json::Value::from(*value)));
            print_line!("{:#}", serde_json::Value::from_iter(values));
        } else {
            print_line!("{text}");
        }
    }

    /// Writes the origin of a work coordinate system such that positions get a coordinate.
    fn set_zero(
        &self,
        places: &[(usize, f64)],
        zero: &ZeroArgs,
        file: Option<PathBuf>,
    ) -> Result<(), CliError> {
        let (Some(name), Some(file)) = (&zero.set, file) else {
            return Ok(());
        };
        let origins: Vec<(usize, f64)> = places
            .iter()
            .map(|(axis, place)| (*axis, place - zero.to))
            .collect();
        set_origin(&self.machine, &file, name, &origins)?;
        if !self.shared.json {
            print_line!("{} written", offsets_path(&file).display());
        }
        Ok(())
    }

    fn tool(&mut self, args: &ToolArgs, file: Option<PathBuf>) -> Result<(), CliError> {
        let Some(file) = file else { return Ok(()) };
        let z = self.tool_axis(Role::ToolZ)?;
        let axis = model::tool_axis(self.machine.config.model.descriptor());
        let direction = axis.direction(&self.here()?);
        if axis.turns() && direction[2] < 1.0 - ALONG_Z {
            let what = "probe tool: the tool does not stand along Z of the workpiece, so the setter \
                        does not measure its length; turn the rotary coordinates to 0";
            return Err(CliError::new(Exit::Command, what));
        }
        let contact = self.touch(z, -args.reach)?;
        let length = contact - args.height;
        let mut data =
            WorkData::load(&file).map_err(|error| CliError::new(Exit::BadInput, error))?;
        let tool = data.tools.entry(args.tool).or_default();
        tool.offset[2] = length;
        if let Some(diameter) = args.diameter {
            tool.diameter = diameter;
        }
        data.save_tools(&file)
            .map_err(|error| CliError::new(Exit::Output, error))?;
        let text = format!("T{} length {length:.4} mm", args.tool);
        self.print(&[("length".to_string(), length)], &text);
        if !self.shared.json {
            print_line!("{} written", tools_path(&file).display());
        }
        Ok(())
    }
}
