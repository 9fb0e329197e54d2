//! Telemetry as CSV: one row per frame, in mm, degrees, newtons.
//!
//! A thread writes, so a slow disk delays nothing. The file name is the UTC start time; existing
//! files are never overwritten.

use crate::commands::status::path_speed;
use haptimill_firmware::config::AxisKind;
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::scale::{PER_EFFORT, PER_MM, per_unit};
use haptimill_protocol::message::{AxisValues, Telemetry};
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{self, Sender};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{SystemTime, UNIX_EPOCH};

/// Recording in progress.
pub(super) struct Recording {
    /// File.
    pub(super) path: PathBuf,
    /// Rows passed to the writer.
    pub(super) rows: u64,
    rows_to: Option<Sender<Box<Telemetry>>>,
    failed: Arc<Mutex<Option<String>>>,
    writer: Option<JoinHandle<()>>,
}

/// Time for a file name: 20260131T235959Z.
fn stamp(time: SystemTime) -> String {
    let seconds = time
        .duration_since(UNIX_EPOCH)
        .map_or(0, |since| since.as_secs());
    let (days, of_day) = ((seconds / 86_400) as i64, seconds % 86_400);
    // Conversion of days to the civil calendar, with years that start in March.
    let shifted = days + 719_468;
    let era = shifted.div_euclid(146_097);
    let day_of_era = shifted.rem_euclid(146_097);
    let year_of_era =
        (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let month_from_march = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * month_from_march + 2) / 5 + 1;
    let month = if month_from_march < 10 {
        month_from_march + 3
    } else {
        month_from_march - 9
    };
    let year = year_of_era + era * 400 + i64::from(month <= 2);
    format!(
        "{year:04}{month:02}{day:02}T{:02}{:02}{:02}Z",
        of_day / 3600,
        of_day / 60 % 60,
        of_day % 60
    )
}

/// Names and scales of the columns.
struct Columns {
    period_s: f64,
    pose: Vec<(String, AxisKind)>,
    joints: Vec<(String, AxisKind)>,
    force: bool,
}

impl Columns {
    fn from_machine(machine: &MachineFile) -> Self {
        let list = |axes: &[haptimill_machine_file::AxisLimits]| {
            axes.iter()
                .map(|axis| (axis.name.clone(), axis.kind))
                .collect()
        };
        Self {
            period_s: f64::from(machine.config.period_us) * 1e-6,
            pose: list(&machine.pose),
            joints: list(&machine.joints),
            force: machine.config.force.is_some(),
        }
    }

    fn header(&self) -> String {
        let mut header = "time_s,period,state,homed,setpoint,speed_factor,program_s".to_string();
        let mut add = |quantity: &str, axes: &[(String, AxisKind)], unit: bool| {
            for (name, kind) in axes {
                let unit = match (unit, kind) {
                    (false, _) => "",
                    (true, AxisKind::Linear) => "_mm",
                    (true, AxisKind::Rotary | AxisKind::MultiTurn) => "_deg",
                };
                header.push_str(&format!(",{quantity}_{name}{unit}"));
            }
        };
        add("commanded", &self.pose, true);
        add("measured", &self.pose, true);
        add("joint", &self.joints, true);
        add("following_error", &self.joints, true);
        add("drive", &self.joints, false);
        if self.force {
            for (quantity, unit) in [
                ("force_high", "n"),
                ("force_low", "n"),
                ("displacement", "mm"),
            ] {
                for name in ["x", "y", "z"] {
                    header.push_str(&format!(",{quantity}_{name}_{unit}"));
                }
            }
            header.push_str(",force_mask");
        }
        header.push('\n');
        header
    }

    fn row(&self, of: &Telemetry) -> String {
        let mut row = format!(
            "{:.4},{},{:?},{},{},{:.4},{:.4}",
            of.period as f64 * self.period_s,
            of.period,
            of.state,
            u8::from(of.homed),
            of.setpoint,
            path_speed(of),
            f64::from(of.program_periods) * self.period_s
        );
        let joints = &self.joints;
        let mut add = |axes: &[(String, AxisKind)], values: &AxisValues, unwound: bool| {
            for (index, (name, kind)) in axes.iter().enumerate() {
                row.push(',');
                // Unknown values stay empty.
                if let Some(value) = values.get(index) {
                    let turns = unwound && kind.is_circular();
                    let joint = joints.iter().position(|(joint, _)| turns && joint == name);
                    let value = of.unwound(joint, *value) as f64;
                    row.push_str(&format!("{:.6}", value / per_unit(*kind)));
                }
            }
        };
        add(&self.pose, &of.commanded, true);
        add(&self.pose, &of.measured, true);
        add(&self.joints, &of.joints, true);
        add(&self.joints, &of.following_error, false);
        for index in 0..self.joints.len() {
            row.push(',');
            if let Some(code) = of.drive.get(index) {
                row.push_str(&code.to_string());
            }
        }
        if self.force {
            match &of.force {
                Some(force) => {
                    let newtons = force.high.iter().chain(&force.low);
                    for value in newtons {
                        row.push_str(&format!(",{:.4}", f64::from(*value) / PER_EFFORT));
                    }
                    for value in force.displacement {
                        row.push_str(&format!(",{:.6}", f64::from(value) / PER_MM));
                    }
                    row.push_str(&format!(",{}", force.mask));
                }
                None => row.push_str(&",".repeat(10)),
            }
        }
        row.push('\n');
        row
    }
}

impl Recording {
    /// Starts a recording in a folder.
    ///
    /// # Errors
    /// The file cannot be created.
    pub(super) fn begin(folder: &Path, machine: &MachineFile) -> Result<Self, String> {
        let stamp = stamp(SystemTime::now());
        // Several recordings within one second get a number.
        let names = (1..100).map(|number| match number {
            1 => format!("console-{stamp}.csv"),
            number => format!("console-{stamp}-{number}.csv"),
        });
        let mut reason = String::new();
        for name in names {
            let path = folder.join(name);
            match File::create_new(&path) {
                Ok(file) => return Ok(Self::into(path, file, Columns::from_machine(machine))),
                Err(error) if error.kind() == std::io::ErrorKind::AlreadyExists => {}
                Err(error) => {
                    reason = format!(
                        "{}: {error}; choose another folder with --out",
                        path.display()
                    );
                    break;
                }
            }
        }
        Err(reason)
    }

    fn into(path: PathBuf, file: File, columns: Columns) -> Self {
        let (rows_to, rows) = mpsc::channel::<Box<Telemetry>>();
        let failed = Arc::new(Mutex::new(None));
        let message = Arc::clone(&failed);
        let name = path.display().to_string();
        let writer = std::thread::spawn(move || {
            let mut out = BufWriter::new(file);
            let write = || -> std::io::Result<()> {
                out.write_all(columns.header().as_bytes())?;
                let mut unflushed = 0;
                for row in rows {
                    out.write_all(columns.row(&row).as_bytes())?;
                    unflushed += 1;
                    // Rows that a crash may lose: half a second.
                    if unflushed >= 25 {
                        out.flush()?;
                        unflushed = 0;
                    }
                }
                out.flush()
            };
            if let Err(error) = write()
                && let Ok(mut message) = message.lock()
            {
                *message = Some(format!("{name}: {error}; the rows written so far are kept"));
            }
        });
        Self {
            path,
            rows: 0,
            rows_to: Some(rows_to),
            failed,
            writer: Some(writer),
        }
    }

    /// Adds a frame.
    ///
    /// # Errors
    /// The writer failed.
    pub(super) fn add(&mut self, telemetry: &Telemetry) -> Result<(), String> {
        let sent = self
            .rows_to
            .as_ref()
            .is_some_and(|rows| rows.send(Box::new(telemetry.clone())).is_ok());
        if !sent {
            let reason = self.failed.lock().ok().and_then(|failed| failed.clone());
            return Err(reason.unwrap_or_else(|| "the recording ended".to_string()));
        }
        self.rows += 1;
        Ok(())
    }
}

impl Drop for Recording {
    fn drop(&mut self) {
        self.rows_to = None;
        if let Some(writer) = self.writer.take() {
            let _ = writer.join();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn time_stamp_is_civil_time() {
        let at = |seconds| stamp(UNIX_EPOCH + Duration::from_secs(seconds));
        assert_eq!(at(0), "19700101T000000Z");
        assert_eq!(at(951_782_399), "20000228T235959Z");
        assert_eq!(at(951_782_400), "20000229T000000Z");
        assert_eq!(at(951_868_800), "20000301T000000Z");
        assert_eq!(
            at(1_798_761_599),
            "2026-12-31T23:59:59Z".replace(['-', ':'], "")
        );
        assert_eq!(at(4_107_542_400), "21000301T000000Z");
    }

    #[test]
    fn every_row_has_the_columns_of_the_header() {
        let machine = MachineFile::built_in().unwrap();
        let columns = Columns::from_machine(&machine);
        let count = |line: &str| line.matches(',').count();
        let mut telemetry = telemetry();
        assert_eq!(count(&columns.row(&telemetry)), count(&columns.header()));
        // Angles count on over the turns of the joint of their name.
        telemetry.turns = [0, 0, 0, 0, 2].into_iter().collect();
        let row = columns.row(&telemetry);
        assert_eq!(row.matches(",720.087891").count(), 3, "{row}");
        telemetry.measured.clear();
        telemetry.force = None;
        assert_eq!(count(&columns.row(&telemetry)), count(&columns.header()));
    }

    fn telemetry() -> Telemetry {
        let five: AxisValues = [1 << 20; 5].into_iter().collect();
        Telemetry {
            period: 5000,
            state: haptimill_protocol::message::State::Idle,
            homed: true,
            credit: 0,
            setpoint: 0,
            program_periods: 0,
            speed_factor: 0,
            commanded: five.clone(),
            measured: five.clone(),
            joints: five.clone(),
            turns: AxisValues::new(),
            following_error: five.clone(),
            open_loop: 0,
            drive: five,
            fault: None,
            deferred_bytes: 0,
            bad_frames: 0,
            lost_bytes: 0,
            io: None,
            more: Default::default(),
            force: Some(haptimill_protocol::force::ForceTelemetry {
                high: [65_536; 3],
                low: [0; 3],
                displacement: [0; 3],
                mask: 1,
                tared: true,
                problem: None,
            }),
        }
    }
}
