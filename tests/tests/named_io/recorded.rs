//! Named inputs and outputs in a recording: their columns, the places and periods of their changes,
//! and the replay.

use super::*;
use haptimill_hil_sim::fault::Fault as Injected;
use haptimill_tests::job;
use haptimill_trace::{Column, Period, Record, Recording, columns, replay};

/// Outputs at places of a line along x from the home pose; each move is 5 mm.
const PROGRAM: &str = "G21 G91 G64 Q0 F600
M7
G1 X5
M8
G1 X5
M9
M62 P4
G1 X5
M65 P4
M68 E0 Q4.5
G1 X5
M68 E0 Q1.5
G1 X5
M30
";

/// A program moves at 10 mm/s: 2 um in a control period of 200 us. A setpoint is reached within a
/// period.
const PLACE: f64 = 0.003;

/// Columns of outputs: name, and the place from which and to which the output has a value, mm from
/// the home pose. Coolant ends with the job if not before.
const OUTPUTS: [(&str, f64, f64, f64); 5] = [
    ("output_mist", 1.0, 0.0, 10.0),
    ("output_coolant", 1.0, 5.0, 10.0),
    ("output_light", 1.0, 10.0, 15.0),
    ("output_laser", 4.5, 15.0, 20.0),
    ("output_laser", 1.5, 20.0, 25.0),
];

/// Runs the program on the mill, with a level forced to an input, and records it.
fn recorded(path: &std::path::Path) -> Recording {
    let machine = MachineFile::parse("mill3-servo.toml", MILL).expect("sound");
    let plan = job::plan(&machine, PROGRAM).unwrap_or_else(|refused| panic!("{refused}"));
    // During the job.
    let fault = "input-level name=air-pressure level=low at=2.5s for=0.5s";
    let fault: Injected = fault.parse().expect("a fault");
    let mut session = job::homed(&machine, vec![fault]);
    job::begin_recording(&mut session, path, &plan, &machine, |_| ());
    job::run(&mut session, 2, &machine, &plan);
    job::end_recording(&mut session);
    Recording::open(path).expect("readable")
}

/// Values of a column in all records: period, place of x from the home pose, value.
fn values(name: &str, all: &[Column], records: &[Record]) -> Vec<(u64, f64, f64)> {
    let column = |name: &str| {
        let found = all.iter().find(|column| column.name == name);
        found.unwrap_or_else(|| panic!("no column {name}"))
    };
    let (place, column) = (column("x_commanded_mm"), column(name));
    let number = |column: &Column, record| {
        let value = column.value(record, 0.0);
        value.expect("a value").number()
    };
    let rows = records.iter();
    rows.map(|row| (row.period, number(place, row), number(column, row)))
        .collect()
}

/// The columns have the names of the machine file. An output changes at its place in the program,
/// and its column in the period in which the pin changes. A replay gives the same.
#[test]
fn a_recording_has_named_columns_with_the_values_of_the_pins() {
    let folder = tempfile::tempdir().expect("a folder");
    let recording = recorded(&folder.path().join("io.hmr"));
    let all = columns(&recording);
    let named: Vec<&str> = all
        .iter()
        .filter(|column| ["input", "output"].contains(&column.group))
        .map(|column| column.name.as_str())
        .collect();
    assert_eq!(
        named,
        [
            "input_probe",
            "input_setter",
            "input_feed-hold",
            "input_door",
            "input_air-pressure",
            "output_coolant",
            "output_mist",
            "output_clamp",
            "output_spindle-reverse",
            "output_light",
            "input_load",
            "output_laser",
        ]
    );
    let records = recording.iter().expect("readable");
    let records: Vec<Record> = records.map(|record| record.expect("a record")).collect();
    let periods = recording.read_periods().expect("readable");
    let periods: Vec<Period> = periods.map(|period| period.expect("a period")).collect();
    let first = periods[0].inputs.period;
    let pins = |period: u64| &periods[(period - first) as usize];

    // At their places in the program.
    for (name, value, from, to) in OUTPUTS {
        let rows = values(name, &all, &records);
        let on = rows.iter().filter(|row| (row.2 - value).abs() < 1e-3);
        let places: Vec<f64> = on.map(|row| row.1).collect();
        let (low, high) = places.iter().fold((f64::MAX, f64::MIN), |(low, high), at| {
            (low.min(*at), high.max(*at))
        });
        println!(
            "{name} {value}: {low:.4} to {high:.4} mm in {} periods",
            places.len()
        );
        assert!((low - from).abs() < PLACE, "{name}: from {low}");
        assert!((high - to).abs() < PLACE, "{name}: to {high}");
    }
    // In the periods of the pins. The clamp is on at a low level.
    for (name, channel, inverted) in [
        ("output_coolant", 0, false),
        ("output_mist", 1, false),
        ("output_clamp", 2, true),
        ("output_spindle-reverse", 3, false),
        ("output_light", 4, false),
    ] {
        for (period, _, value) in values(name, &all, &records) {
            let pin = pins(period).outputs.digital >> channel & 1 != 0;
            assert_eq!(pin != inverted, value != 0.0, "{name} in period {period}");
        }
    }
    for (period, _, value) in values("output_laser", &all, &records) {
        let volts = f64::from(pins(period).outputs.analog[0]) / 32_768.0 * 10.0;
        assert!((volts - value).abs() < 1e-6, "laser in period {period}");
    }
    // The input follows its pin after the filter of 2 ms.
    let level = |period: u64| pins(period).inputs.digital >> 4 & 1 != 0;
    let changes = |level: &dyn Fn(usize) -> bool| -> Vec<u64> {
        let changed = (1..records.len()).filter(|row| level(*row) != level(row - 1));
        changed.map(|row| records[row].period).collect()
    };
    let rows = values("input_air-pressure", &all, &records);
    let pin = changes(&|row| level(records[row].period));
    let column = changes(&|row| rows[row].2 != 0.0);
    println!("pin {pin:?}, column {column:?}");
    assert_eq!(pin.len(), 2, "the level falls and rises during the job");
    let filter = 2000 / u64::from(recording.config().period_us);
    let after: Vec<u64> = pin.iter().map(|period| period + filter).collect();
    assert_eq!(column, after);

    let equal = replay::replay(&recording)
        .expect("replayable")
        .expect("equal");
    assert_eq!(equal.periods, periods.len() as u64);
    assert_eq!(equal.records, records.len() as u64);
}
