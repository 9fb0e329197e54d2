//! The ball-end mill of Altintas and Lee (docs/control.md 5.1), divided into slices for the inner
//! loop.
//!
//! The meridian of the ball is divided into equal angles kappa from the tip to the equator, and the
//! shank above it into equal heights. A *node* is a boundary; a *slice* lies between two nodes. In
//! kappa the formulas are smooth down to the tip: with z = R_0 (1 - cos kappa) and psi = z tan(i_0)
//! / R_0 they become db = dz / sin kappa = R_0 d kappa and dS = R_0 sqrt(1 + tan^2 i_0 sin^4 kappa)
//! d kappa. On the shank db = dz and dS = dz / cos i_0.

use crate::process::config::CutterConfig;

/// One circle of the cutter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Node {
    /// Sine of the axial angle kappa.
    pub sin_kappa: f64,
    /// Cosine of the axial angle kappa; 0 on the shank.
    pub cos_kappa: f64,
    /// Sine of the lag angle psi.
    pub sin_lag: f64,
    /// Cosine of the lag angle psi.
    pub cos_lag: f64,
    /// Radius of the circle, mm.
    pub radius: f64,
    /// Height above the ball's centre, mm; negative on the ball.
    pub height: f64,
    /// Tolerance of the workpiece's map at this node, along the normal, mm.
    pub tolerance: f64,
}

/// Piece of an edge between two nodes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Slice {
    /// Width of the chip db, mm.
    pub width: f64,
    /// Length of the edge dS, mm.
    pub edge: f64,
}

/// A cutter, divided into slices.
#[derive(Debug, Clone)]
pub struct Cutter {
    nodes: Vec<Node>,
    slices: Vec<Slice>,
}

impl Cutter {
    /// Divides a cutter into slices for a map with grid spacing `cell`, mm. The configuration must
    /// have passed its check.
    pub fn new(config: &CutterConfig, cell: f64) -> Self {
        let radius = config.radius_mm;
        let tan_helix = libm::tan(config.helix_deg * (core::f64::consts::PI / 180.0));
        let lag = |height: f64| libm::sincos((height + radius) * tan_helix / radius);
        let step = core::f64::consts::FRAC_PI_2 / config.slices as f64;
        let mut nodes = Vec::new();
        let mut slices = Vec::new();
        for k in 0..=config.slices {
            let (sin_kappa, cos_kappa) = if k == config.slices {
                (1.0, 0.0)
            } else {
                libm::sincos(k as f64 * step)
            };
            let height = -radius * cos_kappa;
            let (sin_lag, cos_lag) = lag(height);
            let curved = cell * cell / (4.0 * radius);
            let steep = 1.5 * cell;
            nodes.push(Node {
                sin_kappa,
                cos_kappa,
                sin_lag,
                cos_lag,
                radius: radius * sin_kappa,
                height,
                // Next to the shank's wall the map has no slope.
                tolerance: if radius * (1.0 - sin_kappa) > steep {
                    curved / (cos_kappa * cos_kappa)
                } else {
                    steep
                },
            });
            if k < config.slices {
                // Simpson's rule: the root is smooth enough for an error below 1e-9.
                let density = |kappa: f64| {
                    let sin = libm::sin(kappa);
                    let turn = tan_helix * sin * sin;
                    (1.0 + turn * turn).sqrt()
                };
                let low = k as f64 * step;
                let mean =
                    (density(low) + 4.0 * density(low + 0.5 * step) + density(low + step)) / 6.0;
                slices.push(Slice {
                    width: radius * step,
                    edge: radius * step * mean,
                });
            }
        }
        let shank = config.flute_length_mm - radius;
        let count = (shank / (radius * step)).ceil() as usize;
        for k in 1..=count {
            let thickness = shank / count as f64;
            let height = k as f64 * thickness;
            let (sin_lag, cos_lag) = lag(height);
            nodes.push(Node {
                sin_kappa: 1.0,
                cos_kappa: 0.0,
                sin_lag,
                cos_lag,
                radius,
                height,
                tolerance: 1.5 * cell,
            });
            slices.push(Slice {
                width: thickness,
                edge: thickness * (1.0 + tan_helix * tan_helix).sqrt(),
            });
        }
        Self { nodes, slices }
    }

    /// Nodes, from the tip upwards; one more than slices.
    pub fn nodes(&self) -> &[Node] {
        &self.nodes
    }

    /// Slices, from the tip upwards.
    pub fn slices(&self) -> &[Slice] {
        &self.slices
    }
}
