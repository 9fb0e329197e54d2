//! `haptimill probe edge`, `bore`, `boss` and `tool`: probing cycles.

use super::args::{BoardArg, ConnectArgs};
use super::board::file_of;
use super::jog::{AxisRate, axis_index, check_feed};
use super::probing::{Touch, find_input, probe_along};
use super::simple::open;
use super::{CliError, Exit, output};
use clap::{Args, Subcommand};
use haptimill_client::session::{
    NoObserver, PortLine, Session, check_has_tool, plan_straight_move,
};
use haptimill_firmware::config::AxisKind;
use haptimill_gcode::{Coordinates, SYSTEM_NAMES};
use haptimill_kinematics::descriptor::Role;
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::work_data::{self, WorkData, offsets_path, system_index, tools_path};
use std::path::{Path, PathBuf};

/// A probing cycle.
#[derive(Debug, Clone, Subcommand)]
pub enum ProbeCycle {
    /// Find an edge or a face along one axis, and optionally make it the zero of a work offset
    Edge(EdgeArgs),
    /// Find the centre of a bore from inside, and move there
    Bore(BoreArgs),
    /// Find the centre of a boss from above its middle, and move there
    Boss(BossArgs),
    /// Measure the length of a tool on the tool setter, and write it into the tool table
    Tool(ToolArgs),
}

/// Arguments that all cycles share.
#[derive(Debug, Clone, Args)]
pub struct CycleArgs {
    /// Feed of the measuring touch, mm/min
    #[arg(long, value_name = "FEED", default_value_t = 60.0)]
    pub feed: f64,
    /// Feed of the first touch, which finds the surface, and of the moves between, mm/min
    #[arg(long, value_name = "FEED", default_value_t = 300.0)]
    pub search_feed: f64,
    /// Distance back between the two touches, mm
    #[arg(long, value_name = "MM", default_value_t = 2.0)]
    pub back_off: f64,
    /// Input of the contact [default: the one with the function of the cycle]
    #[arg(long, value_name = "NAME")]
    pub input: Option<String>,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub machine: BoardArg,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub connect: ConnectArgs,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}

/// The work offset that a cycle sets.
#[derive(Debug, Clone, Args)]
pub struct ZeroArgs {
    /// Set the origin of this work coordinate system there: g54 to g59, g59.1 to g59.3; needs
    /// --machine
    #[arg(long, value_name = "SYSTEM")]
    pub set: Option<String>,
    /// With --set: the coordinate that the edge or the centre gets, mm
    #[arg(
        long,
        value_name = "MM",
        default_value_t = 0.0,
        requires = "set",
        allow_negative_numbers = true
    )]
    pub to: f64,
}

/// Arguments of `haptimill probe edge`.
#[derive(Debug, Clone, Args)]
#[command(
    about = "Find an edge or a face along one axis",
    long_about = "Find an edge or a face along one axis: `haptimill probe edge z=-20 --radius 0` \
                  moves down by at most 20 mm until the probe touches, goes back, touches again \
                  slowly, and returns to its start. The printed position is that of the surface: \
                  the contact and the radius of the ball."
)]
pub struct EdgeArgs {
    /// Axis and largest distance with its sign, mm, as x=10 or z=-20
    #[arg(value_name = "AXIS=DISTANCE", allow_negative_numbers = true)]
    pub axis: AxisRate,
    /// Radius of the ball of the probe along the axis, mm; 0 if the tip itself touches, as along Z
    /// with a tool that was measured with its tip
    #[arg(long, value_name = "MM")]
    pub radius: f64,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub zero: ZeroArgs,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub cycle: CycleArgs,
}

/// Arguments of `haptimill probe bore`.
#[derive(Debug, Clone, Args)]
pub struct BoreArgs {
    /// Largest distance from the start to the wall, mm
    #[arg(long, value_name = "MM")]
    pub reach: f64,
    /// Radius of the ball of the probe, mm; the diameter depends on it, the centre does not
    #[arg(long, value_name = "MM", default_value_t = 0.0)]
    pub radius: f64,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub zero: ZeroArgs,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub cycle: CycleArgs,
}

/// Arguments of `haptimill probe boss`.
#[derive(Debug, Clone, Args)]
pub struct BossArgs {
    /// Size of the boss along x and y, mm, as 40x35, or its diameter
    #[arg(long, value_name = "MM[xMM]", value_parser = size)]
    pub size: [f64; 2],
    /// Distance down beside the boss, mm
    #[arg(long, value_name = "MM")]
    pub depth: f64,
    /// Distance from the wall at which the probe goes down, ball included, mm
    #[arg(long, value_name = "MM", default_value_t = 5.0)]
    pub clearance: f64,
    /// Radius of the ball of the probe, mm; the size depends on it, the centre does not
    #[arg(long, value_name = "MM", default_value_t = 0.0)]
    pub radius: f64,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub zero: ZeroArgs,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub cycle: CycleArgs,
}

/// Arguments of `haptimill probe tool`.
#[derive(Debug, Clone, Args)]
#[command(
    about = "Measure the length of a tool on the tool setter",
    long_about = "Measure the length of a tool on the tool setter, and write it into the tool \
                  table beside the machine file.\n\nThe tool must be above the setter. The command \
                  moves down to the contact, goes back, touches again slowly, and returns. The \
                  length is the machine's Z at the contact less --height, the Z at which a tool of \
                  length 0 touches: that of the reference tool."
)]
pub struct ToolArgs {
    /// Number of the tool
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=99_999))]
    pub tool: u32,
    /// Machine Z at which the reference tool touches the setter, mm
    #[arg(long, value_name = "MM", allow_negative_numbers = true)]
    pub height: f64,
    /// Largest distance down, mm
    #[arg(long, value_name = "MM", default_value_t = 50.0)]
    pub reach: f64,
    /// Diameter to write with it, mm [default: that of the table]
    #[arg(long, value_name = "MM")]
    pub diameter: Option<f64>,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub cycle: CycleArgs,
}

/// Parses `40x35` or `40`.
fn size(text: &str) -> Result<[f64; 2], String> {
    let (x, y) = text.split_once('x').unwrap_or((text, text));
    match (x.parse::<f64>(), y.parse::<f64>()) {
        (Ok(x), Ok(y)) if x > 0.0 && y > 0.0 && x < 1e4 && y < 1e4 => Ok([x, y]),
        _ => Err("write the size in mm, as 40x35, or a diameter".to_string()),
    }
}

impl ProbeCycle {
    /// Whether standard output is JSON.
    pub(super) const fn is_json(&self) -> bool {
        self.shared().json
    }

    /// The work offset to set; none of a cycle that sets no offset.
    const fn zero(&self) -> Option<&ZeroArgs> {
        match self {
            Self::Edge(args) => Some(&args.zero),
            Self::Bore(args) => Some(&args.zero),
            Self::Boss(args) => Some(&args.zero),
            Self::Tool(_) => None,
        }
    }

    const fn shared(&self) -> &CycleArgs {
        match self {
            Self::Edge(args) => &args.cycle,
            Self::Bore(args) => &args.cycle,
            Self::Boss(args) => &args.cycle,
            Self::Tool(args) => &args.cycle,
        }
    }
}

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
    for (name, value, least) in lengths.into_iter().chain([back_off]) {
        if !(least..=1e4).contains(&value) {
            let what = format!("{name} {value}: write {least} to 10000 mm");
            return Err(CliError::new(Exit::Usage, what));
        }
    }
    Ok(())
}

/// The machine file that the offsets and tools are kept beside.
pub(crate) fn kept_beside(machine: &MachineFile) -> Result<PathBuf, CliError> {
    let path = PathBuf::from(&machine.file);
    if path.is_file() {
        // Damaged files are refused before the machine moves.
        WorkData::load(&path).map_err(|error| CliError::new(Exit::BadInput, error))?;
        return Ok(path);
    }
    let what = "offsets and tools are kept beside a machine file, and this machine is built in; \
                give a copy of its file with --machine (`haptimill machine init`)";
    Err(CliError::new(Exit::Usage, what))
}

/// The centre between two pairs of walls, and their distances between the contacts.
struct Centre {
    at: [f64; 2],
    across: [f64; 2],
}

/// A session that probes.
struct Prober<'a> {
    session: Session<PortLine>,
    machine: MachineFile,
    input: u8,
    shared: &'a CycleArgs,
}

impl Prober<'_> {
    /// The commanded pose, mm and degrees.
    fn here(&mut self) -> Result<Coordinates, CliError> {
        let status = self.session.status()?;
        Ok(self.session.model().to_engineering_units(&status.commanded))
    }

    /// Moves along a straight line.
    fn go(&mut self, to: Coordinates) -> Result<(), CliError> {
        let from = self.session.status()?.commanded;
        let model = self.session.model();
        let to = model.to_axis_units(&to);
        if from == to {
            return Ok(());
        }
        let feed = Some(self.shared.search_feed);
        let plan = plan_straight_move(&self.machine, model, &from, &to, feed)?;
        let end = self
            .session
            .run_job(MOVE_JOB, from, plan.setpoints, &mut NoObserver)?;
        Ok(self.session.check_completed(&end)?)
    }

    /// One touch along an axis; `None` without a contact.
    fn approach(&mut self, axis: usize, distance: f64, feed: f64) -> Result<Option<f64>, CliError> {
        let from = self.session.status()?.commanded;
        let model = self.session.model();
        let mut to = model.to_engineering_units(&from);
        to[axis] += distance;
        let to = model.to_axis_units(&to);
        let plan = plan_straight_move(&self.machine, model, &from, &to, Some(feed))?;
        let contact = probe_along(&mut self.session, plan, self.input, false)?;
        let model = self.session.model();
        Ok(contact.map(|contact| model.to_engineering_units(&contact.pose)[axis]))
    }

    /// Touches twice along an axis, the second time slowly, and returns to the start.
    fn touch(&mut self, axis: usize, distance: f64) -> Result<f64, CliError> {
        let start = self.here()?;
        let name = self.machine.io.inputs[usize::from(self.input)].clone();
        let missing = |what: &str| {
            let what = format!("{what} without a contact of {name}");
            CliError::new(Exit::Command, what)
        };
        let Some(first) = self.approach(axis, distance, self.shared.search_feed)? else {
            self.go(start)?;
            let axis = &self.machine.pose[axis].name;
            return Err(missing(&format!("the probe moved {axis} by {distance} mm")));
        };
        let sign = distance.signum();
        let back_off = self.shared.back_off;
        let mut back = start;
        // Not beyond the start, where the way is known to be free.
        back[axis] = if (first - sign * back_off - start[axis]) * sign > 0.0 {
            first - sign * back_off
        } else {
            start[axis]
        };
        self.go(back)?;
        let way = (first - back[axis]) + sign * back_off;
        let second = self.approach(axis, way, self.shared.feed)?;
        self.go(start)?;
        second.ok_or_else(|| missing("the second touch ended"))
    }

    fn edge(&mut self, args: &EdgeArgs, file: Option<PathBuf>) -> Result<(), CliError> {
        let axis = self.linear_axis(&args.axis.axis)?;
        let distance = args.axis.rate;
        if distance == 0.0 {
            let what = format!("{}=0: write the largest distance", args.axis.axis);
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

    /// Index of a linear axis by name or letter.
    fn linear_axis(&self, name: &str) -> Result<usize, CliError> {
        let axis = axis_index(&self.machine, name)?;
        if self.machine.pose[axis].kind == AxisKind::Linear {
            return Ok(axis);
        }
        let what = format!("{name} is a rotary axis; probe along a linear one");
        Err(CliError::new(Exit::Usage, what))
    }

    /// Index of the coordinate that moves the tool along x, y or z.
    fn tool_axis(&self, role: Role) -> Result<usize, CliError> {
        let descriptor = self.machine.config.model.descriptor();
        descriptor.coordinate(role).ok_or_else(|| {
            let what = format!(
                "{}: no coordinate moves the tool along {}; probe along single axes with `edge`",
                self.machine.file,
                match role {
                    Role::ToolX => "x",
                    Role::ToolY => "y",
                    _ => "z",
                }
            );
            CliError::new(Exit::BadInput, what)
        })
    }

    /// Touches both walls along an axis and moves to the middle.
    fn walls(
        &mut self,
        axis: usize,
        mut touch: impl FnMut(&mut Self, f64) -> Result<f64, CliError>,
    ) -> Result<(f64, f64), CliError> {
        let (low, high) = (touch(self, -1.0)?, touch(self, 1.0)?);
        let mut middle = self.here()?;
        middle[axis] = f64::midpoint(low, high);
        self.go(middle)?;
        Ok((f64::midpoint(low, high), (high - low).abs()))
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

    /// From above: out along an axis, down, touches on the way back, up and back.
    fn touch_beside(
        &mut self,
        [axis, z]: [usize; 2],
        out: f64,
        depth: f64,
    ) -> Result<f64, CliError> {
        let above = self.here()?;
        let mut beside = above;
        beside[axis] += out;
        self.go(beside)?;
        let mut low = beside;
        low[z] -= depth;
        self.go(low)?;
        let found = self.touch(axis, -out);
        // Up before anything else, also without a contact.
        self.go(beside)?;
        self.go(above)?;
        found
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

/// The host's number of the moves of a cycle.
const MOVE_JOB: u32 = 3;

/// Index of a work coordinate system.
fn find_system(name: &str) -> Result<usize, CliError> {
    system_index(name).ok_or_else(|| {
        let known = SYSTEM_NAMES.map(str::to_lowercase).join(", ");
        let what = format!("{name}: no work coordinate system; write one of {known}");
        CliError::new(Exit::Usage, what)
    })
}

/// Index of a work coordinate system whose single coordinates can be set, and the work data.
fn settable_system(file: &Path, name: &str) -> Result<(usize, WorkData), CliError> {
    let index = find_system(name)?;
    let data = WorkData::load(file).map_err(|error| CliError::new(Exit::BadInput, error))?;
    if data.offsets.systems[index].rotation == 0.0 {
        return Ok((index, data));
    }
    let what = format!(
        "{name} is turned about z, so its origin does not follow from single coordinates; set \
         rotation=0 first (`haptimill offset set`)"
    );
    Err(CliError::new(Exit::Refused, what))
}

/// Writes coordinates of the origin of a work coordinate system: indices of pose coordinates, and
/// mm or degrees of the machine.
///
/// # Errors
/// The name of the system is wrong, it is turned, or the file cannot be written.
pub(crate) fn set_origin(
    machine: &MachineFile,
    file: &Path,
    system: &str,
    origins: &[(usize, f64)],
) -> Result<(), CliError> {
    let (index, mut data) = settable_system(file, system)?;
    let described = machine.config.model.descriptor().pose;
    for (axis, origin) in origins {
        let letter = described.get(*axis).map(|axis| axis.letter.to_string());
        let slot = letter.and_then(|letter| work_data::axis_index(&letter));
        if let Some(slot) = slot {
            data.offsets.systems[index].origin[slot] = *origin;
        }
    }
    data.save_offsets(file)
        .map_err(|error| CliError::new(Exit::Output, error))
}
