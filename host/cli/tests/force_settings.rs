//! Settings of force control that belong to a machine file, to a run, or to `force set`.
#![cfg(unix)]

use crate::scene;
use scene::{SimServer, TestFolder, haptimill};

const SHORT: &str = "G21 G90 F600\nG1 X-1\nM30\n";

/// A machine file that has axes under force control from its start is homed and run: the move to
/// the home pose comes before the tare.
#[test]
fn axes_under_control_from_the_start_home_and_run() {
    let folder = TestFolder::new();
    let text = haptimill_machine_file::BUILT_IN;
    assert!(text.contains("under_control = []"));
    let text = text.replacen("under_control = []", "under_control = [\"z\"]", 1);
    let machine = folder.file("own.toml", text);
    let (program, out) = (folder.file("short.ngc", SHORT), folder.path("out"));
    let run = ["run", &program, "--machine", &machine, "--out", &out];
    haptimill(&run).expect_code(0);
    assert_eq!(folder.summary("out")["completed"], true);

    let served = SimServer::on_tcp(&["--machine", &machine]);
    served.run_ok(&["home", "--machine", &machine]);
    let force = served.run_ok(&["force", "show", "--json"]).json();
    assert_eq!(
        force["under_control"],
        serde_json::json!(["z"]),
        "{force:#}"
    );
}

/// The axes and settings of `run --force` end with the run; those of `force set` stay.
#[test]
fn force_settings_of_a_run_end_with_it() {
    let folder = TestFolder::new();
    let (program, out) = (folder.file("short.ngc", SHORT), folder.path("out"));
    let served = SimServer::on_tcp(&[]);
    let show = || served.run_ok(&["force", "show", "--json"]).json();
    let before = show();
    assert_eq!(before["under_control"], serde_json::json!([]), "{before:#}");
    let options = ["--force", "x", "--force-setpoint", "3"];
    let run = ["run", &program, "--out", &out];
    served.run_ok(&[&run[..], &options].concat());
    let after = show();
    assert_eq!(after["under_control"], before["under_control"], "{after:#}");
    assert_eq!(after["loops"], before["loops"], "{after:#}");

    served.run_ok(&["force", "set", "z", "--force-setpoint", "4"]);
    served.run_ok(&[&run[..], &options].concat());
    let after = show();
    assert_eq!(
        after["under_control"],
        serde_json::json!(["z"]),
        "{after:#}"
    );
    assert_eq!(after["loops"]["z"]["setpoint_n"], 4.0, "{after:#}");
}
