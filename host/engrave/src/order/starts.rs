//! Start points of commands, for the first or the nearest of those that are left.
//!
//! A k-d tree with the box and the first command of each node. Of equally near commands the first
//! of the file is found, also where thousands of them begin in one place.

use crate::geometry::{Point, distance};

/// Starts of a leaf.
const LEAF: usize = 8;

/// Part of the square of a distance by which rounding may be wrong.
const ROUNDING: f64 = 1e-14;

/// The first command of a node in which none is left.
const NONE: u32 = u32::MAX;

/// Starts of the commands that are left.
#[derive(Clone)]
pub struct Starts {
    /// Starts in the order of the leaves, with the numbers of their commands.
    points: Vec<(Point, u32)>,
    /// Place of each command in `points`.
    places: Vec<u32>,
    /// Whether the command at each place is left.
    left: Vec<bool>,
    nodes: Vec<Node>,
}

/// Node k; its halves are the nodes 2 k + 1 and 2 k + 2.
#[derive(Clone, Copy)]
struct Node {
    /// Low and high corner of the starts.
    bounds: [Point; 2],
    /// First of the commands that are left, or [`NONE`].
    first: u32,
}

impl Node {
    /// Square of the distance of the box from a point, a little less than it is.
    #[inline]
    fn square_from(&self, [x, y]: Point) -> f64 {
        let [low, high] = self.bounds;
        low_square([x, y], [x.clamp(low[0], high[0]), y.clamp(low[1], high[1])])
    }
}

/// Square of a distance, a little less than it is: most distances need no root.
#[inline]
fn low_square(a: Point, b: Point) -> f64 {
    let (x, y) = (a[0] - b[0], a[1] - b[1]);
    (x * x + y * y) * (1.0 - ROUNDING)
}

/// The nearest start so far.
struct Nearest {
    off: f64,
    square: f64,
    command: u32,
}

impl Nearest {
    #[inline]
    fn offer(&mut self, at: Point, point: Point, command: u32) {
        if low_square(at, point) > self.square {
            return;
        }
        let off = distance(point, at);
        if off < self.off || off == self.off && command < self.command {
            *self = Self {
                off,
                square: off * off,
                command,
            };
        }
    }
}

/// Part of the tree: node, first place and end of its places.
type Part = (usize, usize, usize);

impl Starts {
    /// Sorts the starts of all commands.
    pub fn new(starts: impl Iterator<Item = Point>) -> Self {
        let points: Vec<(Point, u32)> = starts.zip(0..).collect();
        let count = points.len();
        let mut starts = Self {
            points,
            places: vec![0; count],
            left: vec![true; count],
            nodes: Vec::new(),
        };
        starts.split((0, 0, count));
        for (place, &(_, command)) in starts.points.iter().enumerate() {
            starts.places[command as usize] = place as u32;
        }
        starts
    }

    fn split(&mut self, part: Part) {
        let (index, from, to) = part;
        let points = &mut self.points[from..to];
        let mut bounds = [[f64::INFINITY; 2], [f64::NEG_INFINITY; 2]];
        let mut first = NONE;
        for &(at, command) in &*points {
            for axis in 0..2 {
                bounds[0][axis] = bounds[0][axis].min(at[axis]);
                bounds[1][axis] = bounds[1][axis].max(at[axis]);
            }
            first = first.min(command);
        }
        let node = Node { bounds, first };
        if self.nodes.len() <= index {
            self.nodes.resize(index + 1, node);
        }
        self.nodes[index] = node;
        if to - from > LEAF {
            let [low, high] = bounds;
            let axis = usize::from(high[1] - low[1] > high[0] - low[0]);
            points.select_nth_unstable_by((to - from) / 2, |a, b| {
                a.0[axis].total_cmp(&b.0[axis]).then(a.1.cmp(&b.1))
            });
            let [low, high] = halves(part);
            self.split(low);
            self.split(high);
        }
    }

    /// Whether a command is left.
    pub fn is_left(&self, command: usize) -> bool {
        self.left[self.places[command] as usize]
    }

    /// Start and number of the command at a place, if it is left.
    fn at_place(&self, place: usize) -> Option<(Point, u32)> {
        self.left[place].then(|| self.points[place])
    }

    fn all(&self) -> Part {
        (0, 0, self.points.len())
    }

    /// Takes a command out.
    pub fn remove(&mut self, command: usize) {
        let place = self.places[command] as usize;
        self.left[place] = false;
        self.update(self.all(), place);
    }

    /// Finds the first command of each node around a place anew.
    fn update(&mut self, part: Part, place: usize) {
        let (index, from, to) = part;
        self.nodes[index].first = if to - from <= LEAF {
            let commands = (from..to).filter_map(|place| self.at_place(place));
            commands.map(|(_, command)| command).min().unwrap_or(NONE)
        } else {
            let [low, high] = halves(part);
            self.update(if place < high.1 { low } else { high }, place);
            self.nodes[low.0].first.min(self.nodes[high.0].first)
        };
    }

    /// The first command that is left.
    pub fn first(&self) -> Option<usize> {
        let first = self.nodes[0].first;
        (first != NONE).then_some(first as usize)
    }

    /// The first command that is left and starts within `reach` (mm) of a point.
    pub fn first_within(&self, at: Point, reach: f64) -> Option<usize> {
        let mut found = NONE;
        self.visit_within(at, reach, self.all(), &mut found);
        (found != NONE).then_some(found as usize)
    }

    fn visit_within(&self, at: Point, reach: f64, part: Part, found: &mut u32) {
        let (index, from, to) = part;
        let node = &self.nodes[index];
        if node.first >= *found || node.square_from(at) > reach * reach {
            return;
        }
        if to - from <= LEAF {
            for (point, command) in (from..to).filter_map(|place| self.at_place(place)) {
                if command < *found && distance(point, at) <= reach {
                    *found = command;
                }
            }
            return;
        }
        let mut parts = halves(part);
        parts.sort_by_key(|one| self.nodes[one.0].first);
        for one in parts {
            self.visit_within(at, reach, one, found);
        }
    }

    /// The command that is left and starts nearest to a point; of equally near ones the first.
    pub fn nearest(&self, at: Point) -> Option<usize> {
        let mut best = Nearest {
            off: f64::INFINITY,
            square: f64::INFINITY,
            command: NONE,
        };
        self.visit_nearest(at, self.all(), &mut best);
        (best.command != NONE).then_some(best.command as usize)
    }

    fn visit_nearest(&self, at: Point, part: Part, best: &mut Nearest) {
        let (index, from, to) = part;
        let node = &self.nodes[index];
        if node.first == NONE || node.square_from(at) > best.square {
            return;
        }
        // Starts in one place are equally near.
        if node.bounds[0] == node.bounds[1] {
            best.offer(at, node.bounds[0], node.first);
            return;
        }
        if to - from <= LEAF {
            for (point, command) in (from..to).filter_map(|place| self.at_place(place)) {
                best.offer(at, point, command);
            }
            return;
        }
        let [one, other] = halves(part);
        let min = |part: Part| self.nodes[part.0].square_from(at);
        let (near, far) = if min(other) < min(one) {
            (other, one)
        } else {
            (one, other)
        };
        self.visit_nearest(at, near, best);
        self.visit_nearest(at, far, best);
    }
}

/// Both halves of a part.
fn halves((index, from, to): Part) -> [Part; 2] {
    let half = from + (to - from) / 2;
    [(2 * index + 1, from, half), (2 * index + 2, half, to)]
}
