//! A mill on a test bench: a tool that moves along lines at constant feed.
use haptimill_hil_sim::process::config::Area;
use haptimill_hil_sim::process::{
    Coefficients, Cut, Cutting, CuttingConfig, ToolPose, WorkpieceConfig,
};

pub const PERIOD: f64 = 200e-6;
pub const RPM: f64 = 5000.0;
/// Periods of a spindle revolution.
pub const TURN: usize = 60;

/// A small workpiece around the origin.
pub fn block(x_min: f64, x_max: f64, y_min: f64, y_max: f64) -> WorkpieceConfig {
    WorkpieceConfig {
        stock: Area {
            x_min: -200.0,
            x_max: 200.0,
            y_min: -200.0,
            y_max: 200.0,
        },
        map: Area {
            x_min,
            x_max,
            y_min,
            y_max,
        },
        ..WorkpieceConfig::default()
    }
}

pub fn config(workpiece: WorkpieceConfig, coefficients: Coefficients) -> CuttingConfig {
    let mut config = CuttingConfig {
        workpiece,
        ..CuttingConfig::default()
    };
    config.cutter.coefficients = coefficients;
    config
}

pub struct Bench {
    pub cutting: Cutting,
    pub at: [f64; 3],
    pub rpm: f64,
    pub period: f64,
}

impl Bench {
    pub fn new(config: &CuttingConfig, at: [f64; 3]) -> Self {
        Self {
            cutting: Cutting::new(config, &ToolPose::upright(at)).expect("a mill"),
            at,
            rpm: RPM,
            period: PERIOD,
        }
    }

    /// Runs one period at another position.
    pub fn step(&mut self, at: [f64; 3]) -> Cut {
        self.at = at;
        self.cutting
            .step(&ToolPose::upright(at), self.rpm / 60.0 * self.period)
    }

    /// Moves straight to a position at a feed (mm/s). Returns the forces of all periods.
    pub fn line(&mut self, to: [f64; 3], feed: f64) -> Vec<Cut> {
        let from = self.at;
        let way = [to[0] - from[0], to[1] - from[1], to[2] - from[2]];
        let length = way.iter().map(|part| part * part).sum::<f64>().sqrt();
        let steps = (length / (feed * self.period)).round().max(1.0) as usize;
        (1..=steps)
            .map(|step| {
                let part = step as f64 / steps as f64;
                self.step([
                    from[0] + part * way[0],
                    from[1] + part * way[1],
                    from[2] + part * way[2],
                ])
            })
            .collect()
    }

    /// Stays in place for some periods.
    pub fn stand(&mut self, periods: usize) -> Vec<Cut> {
        let at = self.at;
        (0..periods).map(|_| self.step(at)).collect()
    }
}

/// Mean force of whole revolutions at the end of a record.
pub fn mean(cuts: &[Cut], turns: usize) -> [f64; 3] {
    let tail = &cuts[cuts.len() - turns * TURN..];
    let mut sum = [0.0; 3];
    for cut in tail {
        for (total, part) in sum.iter_mut().zip(cut.force) {
            *total += part / tail.len() as f64;
        }
    }
    sum
}

/// Largest and smallest force of whole revolutions at the end of a record.
pub fn peaks(cuts: &[Cut], turns: usize) -> ([f64; 3], [f64; 3]) {
    let tail = &cuts[cuts.len() - turns * TURN..];
    let (mut high, mut low) = ([f64::NEG_INFINITY; 3], [f64::INFINITY; 3]);
    for cut in tail {
        for i in 0..3 {
            high[i] = high[i].max(cut.force[i]);
            low[i] = low[i].min(cut.force[i]);
        }
    }
    (high, low)
}

/// Largest magnitude of a force.
pub fn largest(cuts: &[Cut]) -> f64 {
    cuts.iter()
        .flat_map(|cut| cut.force)
        .fold(0.0, |max: f64, part| max.max(part.abs()))
}

/// A slot of 20 mm from the origin towards -x, the tool at its end.
pub fn with_slot(feed: f64, depth: f64) -> Bench {
    let config = config(block(-26.0, 6.0, -6.0, 6.0), Coefficients::P1);
    let mut bench = Bench::new(&config, [0.0, 0.0, 1.0]);
    bench.line([0.0, 0.0, -depth], 4.0);
    bench.line([-20.0, 0.0, -depth], feed);
    bench
}
