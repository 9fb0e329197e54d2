//! Writes examples/dome.ngc: a spiral over a dome with the tool normal to the surface, A and B
//! moving with it.
//!
//! `cargo run -p haptimill --example dome > examples/dome.ngc`

/// Radius of the dome's sphere, mm.
const SPHERE_MM: f64 = 60.0;
/// End of the spiral: angle of the surface normal from the vertical, degrees.
const EDGE_DEG: f64 = 15.0;
/// Pitch of the spiral, mm.
const PITCH_MM: f64 = 0.7;
/// Length of a block, mm.
const CHORD_MM: f64 = 0.5;
/// Height of the top of the dome, mm; home is at 21.232.
const TOP_MM: f64 = 20.0;
/// Feed, mm/min.
const FEED: f64 = 480.0;

fn main() {
    let edge = SPHERE_MM * EDGE_DEG.to_radians();
    println!(
        "; Dome in five axes: a spiral from the top outwards over a sphere of radius {SPHERE_MM} mm, its top at X0 Y0 Z{TOP_MM}, the tool"
    );
    println!(
        "; normal to the surface: up to {EDGE_DEG} degrees of tilt, shared by B (tool tilt theta) and A (table alpha)."
    );
    println!(
        "; Coordinates are the tool tip in the work, mm and degrees: the point of a ball-end tool on its axis. As the tool stands normal"
    );
    println!(
        "; to the surface it touches there, so these are also points of the surface. Home is Z21.232. Feed is that of the tip: 8 mm/s."
    );
    println!("; Made by `cargo run -p haptimill --example dome`.");
    println!("G21 G17 G90 G94");
    println!("G64");
    println!("S5000 M3");
    println!("G1 X0 Y0 Z{TOP_MM} B0 A0 F120");
    println!("F{FEED}");
    // Arc length from the top is `r`; the spiral is r = pitch * turns, walked by the chord.
    let mut turn = 0.0f64;
    loop {
        let radius = PITCH_MM * turn / std::f64::consts::TAU;
        if radius > edge {
            break;
        }
        let polar = radius / SPHERE_MM;
        let normal = [
            polar.sin() * turn.cos(),
            polar.sin() * turn.sin(),
            polar.cos(),
        ];
        // Tool axis (I, J, K) = (sin theta, cos theta sin alpha, cos theta cos alpha),
        // docs/control.md (3.27), (3.28).
        let theta = normal[0].atan2(normal[1].hypot(normal[2])).to_degrees();
        let alpha = normal[1].atan2(normal[2]).to_degrees();
        let z = TOP_MM + SPHERE_MM * (normal[2] - 1.0);
        if turn > 0.0 {
            println!(
                "X{:.4} Y{:.4} Z{z:.4} B{theta:.4} A{alpha:.4}",
                SPHERE_MM * normal[0],
                SPHERE_MM * normal[1]
            );
        }
        let growth = PITCH_MM / std::f64::consts::TAU;
        turn += CHORD_MM / radius.hypot(growth);
    }
    println!("G0 Z30");
    println!("X0 Y0 B0 A0");
    println!("Z21.232");
    println!("M5");
    println!("M30");
}
