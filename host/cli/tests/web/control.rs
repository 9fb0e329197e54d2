//! What a viewer commands and sees: jogs, programs, stock, work offsets.

use super::serve;
use super::viewer::{Viewer, has_message};
use crate::scene::{self, SimServer, TestFolder};
use serde_json::{Value, json};
use std::time::{Duration, Instant};
use tungstenite::Message;

#[test]
fn one_viewer_commands_and_every_viewer_stops() {
    let served = serve(&[]);
    let mut first = Viewer::open(&served.address);
    first.take();
    let mut second = Viewer::open(&served.address);
    second.wait_for_state("disabled");
    second.command("enable");
    second.wait("refusal", |viewer| !viewer.refused.is_empty());
    assert_eq!(second.refused, ["take control first"]);
    first.command("enable");
    first.wait_for_state("idle");
    second.wait_for_state("idle");
    second.command("take");
    first.wait("question", |viewer| {
        viewer.control["asks"] == viewer.control["viewers"]
    });
    first.command("keep");
    second.wait("answer", |viewer| viewer.control["asks"].is_null());
    assert!(!second.commands());
    second.command("emergency-stop");
    first.wait_for_state("in emergency stop");
    second.command("take");
    first.wait("question", |viewer| !viewer.control["asks"].is_null());
    first.command("hand-over");
    second.wait("control", Viewer::commands);
    first.command("reset");
    first.wait("refusal", |viewer| !viewer.refused.is_empty());
    drop(second);
    first.wait("nobody", |viewer| viewer.control["commander"].is_null());
}

#[test]
fn a_dropped_connection_ends_a_jog_within_the_jog_timeout() {
    let served = serve(&["--jog-timeout", "200"]);
    let mut watcher = Viewer::open(&served.address);
    let mut viewer = Viewer::open(&served.address);
    viewer.home();
    watcher.wait_for_state("idle");
    // A command that answers an old state moves nothing.
    let late = json!({"command": "jog", "coordinate": 0, "up": true, "repeat": false, "t": 0});
    viewer.socket.send(Message::text(late.to_string())).unwrap();
    viewer.wait("refusal", |viewer| !viewer.refused.is_empty());
    assert_eq!(viewer.refused, ["the connection is slow: nothing was done"]);
    assert_eq!(viewer.state["state"], "idle");
    let begin = viewer.actual(0);
    let jog = |viewer: &mut Viewer| {
        viewer.next();
        viewer.send(json!({"command": "jog", "coordinate": 0, "up": true, "repeat": false}));
        let until = Instant::now() + Duration::from_secs(1);
        while Instant::now() < until {
            viewer.next();
            viewer.send(json!({"command": "jog", "coordinate": 0, "up": true, "repeat": true}));
        }
    };
    // Silence: the connection is open, as a half-open one seems to be.
    jog(&mut viewer);
    let silent = Instant::now();
    viewer.wait_for_state("idle");
    // 200 ms, the deceleration, two states, and a busy computer.
    assert!(
        silent.elapsed() < Duration::from_millis(200 + 800),
        "{:?}",
        silent.elapsed()
    );
    let moved = viewer.actual(0) - begin;
    assert!(
        moved > 2.0 && moved < 10.0,
        "5 mm/s for about 1.2 s: {moved}"
    );
    jog(&mut viewer);
    watcher.wait("old states", |watcher| {
        watcher.state["t"] == viewer.state["t"]
            || watcher.state["t"].as_u64() > viewer.state["t"].as_u64()
    });
    let dropped = Instant::now();
    drop(viewer);
    watcher.wait_for_state("idle");
    assert!(
        dropped.elapsed() < Duration::from_millis(200 + 800),
        "{:?}",
        dropped.elapsed()
    );
    let end = watcher.actual(0);
    let later = Instant::now() + Duration::from_millis(500);
    while Instant::now() < later {
        watcher.next();
    }
    assert!((watcher.actual(0) - end).abs() < 0.05, "it stays");
}

#[test]
fn a_program_is_uploaded_run_held_and_ends_without_its_viewer() {
    let served = serve(&[]);
    served.folder.file("beside.txt.bak", "");
    let mut viewer = Viewer::open(&served.address);
    viewer.home();
    let upload = |viewer: &mut Viewer, name: &str, text: &str| {
        viewer.next();
        viewer.send(json!({"command": "upload", "name": name, "text": text}));
    };
    for name in [
        "../out.ngc",
        "a/b.ngc",
        "/tmp/out.ngc",
        ".hidden.ngc",
        "x.sh",
    ] {
        let before = viewer.refused.len();
        upload(&mut viewer, name, "M30\n");
        viewer.wait("refusal", |viewer| viewer.refused.len() > before);
    }
    upload(
        &mut viewer,
        "part.ngc",
        "G21 G90 F600 S2000 M3\nG1 X8 Y3\nG1 X0\nG1 Y0\nM30\n",
    );
    viewer.wait("list", |viewer| {
        viewer.programs["names"] == json!(["part.ngc"])
    });
    let before = viewer.refused.len();
    upload(&mut viewer, "part.ngc", "M30\n");
    viewer.wait("refusal", |viewer| viewer.refused.len() > before);
    assert_eq!(viewer.refused.last().unwrap(), "part.ngc exists");
    assert!(served.folder.read("part.ngc").contains("G1 X8"));
    viewer.send(json!({"command": "select", "name": "part.ngc"}));
    viewer.wait("scene", |viewer| {
        viewer.scene["scene"]["layers"][0]["points"].is_string()
    });
    viewer.send(json!({"command": "override", "percent": 50}));
    viewer.wait("override", |viewer| viewer.state["override"] == 50);
    for (place, of, percent) in [(1, "rapid", 40), (2, "spindle", 80)] {
        viewer.next();
        viewer.send(json!({"command": "override", "of": of, "percent": percent}));
        viewer.wait(of, |viewer| viewer.state["overrides"][place] == percent);
    }
    viewer.command("run");
    viewer.wait("question", |viewer| viewer.state["question"].is_string());
    viewer.send(json!({"command": "jog", "coordinate": 17, "up": true, "repeat": false}));
    viewer.wait("message", |viewer| {
        has_message(viewer, "there is no coordinate 17")
    });
    viewer.answer();
    viewer.wait("line", |viewer| viewer.state["program"]["line"] == 2);
    // At the override of 80 %.
    viewer.wait("spindle", |viewer| viewer.state["spindle_rpm"] == 1600);
    // The line end of the last line begins no sixth one.
    assert_eq!(viewer.state["program"]["lines"], 5);
    viewer.command("hold");
    viewer.wait_for_state("on hold");
    viewer.command("resume");
    viewer.wait_for_state("running");
    // The job goes on without its viewer.
    drop(viewer);
    let mut watcher = Viewer::open(&served.address);
    watcher.wait("last lines", |watcher| {
        watcher.state["program"]["line"] == 4
    });
    watcher.wait("end", |watcher| has_message(watcher, "part.ngc: done"));
    watcher.wait_for_state("idle");
    assert!(watcher.actual(0).abs() < 0.05 && watcher.actual(1).abs() < 0.05);
    served.command.interrupt();
    let ended = served.command.end();
    assert!(
        ended.err.contains("the machine is at standstill"),
        "{}",
        ended.err
    );
}

/// A viewer that saw every change of the stock, and one that comes afterwards, have one surface.
#[test]
fn the_stock_is_sent_once_and_then_its_changes() {
    let served = serve(&["--stock", "examples/block.toml"]);
    let mut viewer = Viewer::open(&served.address);
    viewer.home();
    viewer.wait("stock", |viewer| !viewer.stock.is_empty());
    let blank = viewer.stock.clone();
    let program = std::fs::read_to_string(scene::root().join("examples/e7-slot.ngc")).unwrap();
    viewer.next();
    viewer.send(json!({"command": "upload", "name": "slot.ngc", "text": program}));
    viewer.wait("list", |viewer| {
        viewer.programs["names"] == json!(["slot.ngc"])
    });
    viewer.send(json!({"command": "select", "name": "slot.ngc"}));
    viewer.wait("path", |viewer| viewer.state["selected"] == "slot.ngc");
    viewer.command("run");
    viewer.answer();
    viewer.wait("end", |viewer| has_message(viewer, "slot.ngc: done"));
    let settled = Instant::now() + Duration::from_secs(2);
    while Instant::now() < settled {
        viewer.next();
    }
    let mut late = Viewer::open(&served.address);
    late.wait("stock", |late| !late.stock.is_empty());
    let settled = Instant::now() + Duration::from_secs(1);
    while Instant::now() < settled {
        late.next();
    }
    assert!(viewer.parts > 3, "{} changes", viewer.parts);
    assert_eq!(viewer.stock, late.stock);
    let deepest = blank
        .iter()
        .zip(&viewer.stock)
        .map(|(blank, now)| blank - now);
    let deepest = deepest.fold(0.0, f64::max);
    assert!((1.9..2.1).contains(&deepest), "{deepest} mm");
}

/// The viewer in control makes the position of the tool the zero of a system; another process of
/// the user holds and resumes the job.
#[test]
fn work_offsets_are_set_and_another_process_holds_the_job() {
    let machine = SimServer::on_tcp(&[]);
    let folder = TestFolder::new();
    let text = std::fs::read_to_string(scene::root().join("machines/h4.toml")).unwrap();
    let file = folder.file("h4.toml", text);
    let served = serve(&["--port", &machine.port, "--machine", &file]);
    let mut viewer = Viewer::open(&served.address);
    viewer.home();
    let systems = |viewer: &Viewer| viewer.state["offsets"]["systems"].clone();
    assert_eq!(systems(&viewer), json!([]));
    let mut other = Viewer::open(&served.address);
    other.wait("state", |other| other.state["ready"] == true);
    other.send(json!({"command": "zero", "text": "g55 z=0"}));
    other.wait("refusal", |other| {
        other.refused.iter().any(|why| why == "take control first")
    });
    viewer.next();
    viewer.send(json!({"command": "zero", "text": "g55 z=0"}));
    viewer.wait("offset", |viewer| systems(viewer)[0]["name"] == "G55");
    let z = viewer.state["offsets"]["letters"].as_array().unwrap();
    let z = z.iter().position(|letter| letter == "z").unwrap();
    let origin = systems(&viewer)[0]["origin"][z].as_f64().unwrap();
    assert!((origin - viewer.actual(z)).abs() < 0.01, "{origin}");
    assert!(folder.read("h4.offsets.toml").contains("g55"));
    viewer.send(json!({"command": "zero", "text": "g99 z=0"}));
    viewer.wait("refusal", |viewer| has_message(viewer, "g99"));

    let text = "G21 G90 F300\nG1 X10\nG1 X0\nG1 X10\nG1 X0\nM30\n";
    viewer.send(json!({"command": "upload", "name": "part.ngc", "text": text}));
    viewer.wait("list", |viewer| {
        viewer.programs["names"] == json!(["part.ngc"])
    });
    viewer.send(json!({"command": "select", "name": "part.ngc"}));
    viewer.wait("path", |viewer| viewer.state["selected"] == "part.ngc");
    let nothing = machine.run(&["resume"]).expect_code(8);
    assert!(nothing.err.contains("not held"), "{nothing:?}");
    viewer.command("run");
    viewer.answer();
    viewer.wait_for_state("running");
    let set = machine.run(&["override", "--feed", "50"]).expect_code(0);
    assert!(set.out.contains("feed 50 %"), "{}", set.out);
    viewer.wait("override", |viewer| viewer.state["override"] == 50);
    machine.run(&["hold"]).expect_code(0);
    viewer.wait_for_state("on hold");
    machine.run(&["resume"]).expect_code(0);
    viewer.wait_for_state("running");
    viewer.wait("end", |viewer| has_message(viewer, "part.ngc: done"));
}

/// A program that is refused is not the selected one any more, and the page has its problems.
#[test]
fn a_refused_program_is_not_selected() {
    let served = serve(&[]);
    served.folder.file("good.ngc", "G21 G90 F300\nG1 X1\nM30\n");
    served
        .folder
        .file("bad.ngc", "G21 F600\nG1 X10\nG1 X900\nM30\n");
    let mut viewer = Viewer::open(&served.address);
    viewer.home();
    viewer.send(json!({"command": "select", "name": "good.ngc"}));
    viewer.wait("path", |viewer| {
        viewer.state["selected"] == "good.ngc" && viewer.state["planning"] == false
    });
    viewer.send(json!({"command": "select", "name": "bad.ngc"}));
    viewer.wait("problems", |viewer| viewer.state["problems"].is_array());
    let problems = viewer.state["problems"].to_string();
    assert!(problems.contains("bad.ngc:3:"), "{problems}");
    assert_eq!(viewer.state["selected"], Value::Null);
    viewer.send(json!({"command": "answer", "yes": false}));
    viewer.wait("no problems", |viewer| viewer.state["problems"].is_null());
    viewer.command("run");
    viewer.wait("refusal", |viewer| {
        has_message(viewer, "run: select a part program first")
    });
    assert_eq!(viewer.state["state"], "idle");
}

/// The push moves the joint with the drives off, onto its switch at 158 mm.
#[test]
fn a_joint_is_moved_off_its_limit_switch_by_the_button() {
    let mill = "machines/mill3-servo.toml";
    let push = "push joint=x effort=45 at=1s for=5s";
    let served = serve(&["--machine", mill, "--fault", push]);
    let mut viewer = Viewer::open(&served.address);
    viewer.take();
    viewer.wait_for_state("disabled");
    let pushed = Instant::now() + Duration::from_millis(6500);
    while Instant::now() < pushed {
        viewer.next();
    }
    viewer.command("enable");
    viewer.wait("refusal", |viewer| {
        has_message(viewer, "x is on its limit switch; move it off")
    });
    assert_eq!(viewer.state["state"], "disabled");
    // The pose is not known so far out.
    let x = |viewer: &Viewer| viewer.state["joints"][0]["actual"].as_f64().unwrap();
    assert!(x(&viewer) > 157.0, "{}", x(&viewer));
    viewer.command("move-off");
    viewer.wait("question", |viewer| {
        let question = viewer.state["question"].as_str().unwrap_or_default();
        question.contains("Move x off its limit switch?")
    });
    viewer.answer();
    viewer.wait("x off its switch", |viewer| {
        viewer.state["state"] == "idle" && (140.0..155.0).contains(&x(viewer))
    });
}
