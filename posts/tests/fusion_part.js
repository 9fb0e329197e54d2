// A part for the test of haptimill.cps: the functions and objects of the post engine that the
// post-processor calls, and the events of a part. Prints the program.
"use strict";
const fs = require("fs");
const path = require("path");
const vm = require("vm");

const lines = [];

function createFormat(options) {
  const decimals = options.decimals === undefined ? 6 : options.decimals;
  return {
    format(value) {
      let text = Number(value).toFixed(decimals);
      if (decimals > 0) {
        text = text.replace(/0+$/, "");
        text = options.forceDecimal ? text : text.replace(/\.$/, "");
      }
      if (/^-0\.?$/.test(text)) {
        text = text.slice(1);
      }
      return (options.prefix || "") + text;
    }
  };
}

// A word that is left out while it does not change.
function createVariable(options, format) {
  let last;
  return {
    format(value) {
      const text = (options.prefix || "") + format.format(value);
      if (text === last && !options.force) {
        return "";
      }
      last = text;
      return text;
    },
    reset() {
      last = undefined;
    }
  };
}

function formatWords(words) {
  return Array.from(words).flat().filter(word => word).join(" ");
}

class Vector {
  constructor(x, y, z) {
    Object.assign(this, {x, y, z});
  }
}

const up = {forward: new Vector(0, 0, 1)};
let position = new Vector(0, 0, 0);
let section, previous, isFirst = true, firstPoint = true, full = false;

const engine = {
  MM: 0, IN: 1, unit: 0, CAPABILITY_MILLING: 1, undefined: undefined,
  PLANE_XY: 0, PLANE_ZX: 1, PLANE_YZ: 2,
  COMMAND_STOP: 1, COMMAND_OPTIONAL_STOP: 2, COMMAND_COOLANT_OFF: 3, COMMAND_STOP_SPINDLE: 4,
  COOLANT_OFF: 0, COOLANT_FLOOD: 1, COOLANT_MIST: 2, RADIUS_COMPENSATION_OFF: 0,
  radiusCompensation: 0, programName: "1001", programComment: "Cover", cycleExpanded: false,
  Vector, createFormat, createVariable, formatWords,
  createReferenceVariable: createVariable,
  createModal: (options, format) => createVariable(options, format),
  setCodePage() {}, spatial: value => value, toRad: degrees => degrees * Math.PI / 180,
  setRotation() {}, writeln: text => lines.push(text),
  error(text) {
    throw new Error(text);
  },
  isFirstSection: () => isFirst, getPreviousSection: () => previous,
  hasParameter: () => true, getParameter: () => section.comment,
  isSameDirection: (a, b) => a.x === b.x && a.y === b.y && a.z === b.z,
  getFramePosition: at => at, getCurrentPosition: () => position,
  getCircularPlane: () => engine.plane, isFullCircle: () => full,
  isFirstCyclePoint: () => firstPoint,
  linearize() {
    throw new Error("linearize");
  },
  expandCyclePoint() {
    throw new Error("expandCyclePoint");
  }
};
vm.createContext(engine);
vm.runInContext(fs.readFileSync(path.join(__dirname, "..", "haptimill.cps"), "utf8"), engine);

function begin(tool, comment, start, workOffset) {
  section = {comment, workPlane: up, workOffset, getTool: () => tool,
    getInitialPosition: () => start};
  Object.assign(engine, {currentSection: section, tool, spindleSpeed: tool.speed});
  engine.onSection();
  position = start;
}

function end() {
  engine.onSectionEnd();
  previous = section;
  isFirst = false;
}

function rapid(x, y, z) {
  engine.onRapid(x, y, z);
  position = new Vector(x, y, z);
}

function line(x, y, z, feed) {
  engine.onLinear(x, y, z, feed);
  position = new Vector(x, y, z);
}

function arc(clockwise, centre, to, feed, plane) {
  engine.plane = plane || 0;
  full = to.every((value, axis) => value === [position.x, position.y, position.z][axis]);
  engine.onCircular(clockwise, ...centre, ...to, feed);
  position = new Vector(...to);
}

function drill(type, cycle, points) {
  Object.assign(engine, {cycleType: type, cycle});
  engine.onCycle();
  points.forEach((point, index) => {
    firstPoint = index === 0;
    engine.onCyclePoint(...point);
  });
  engine.onCycleEnd();
}

const mill = {number: 1, speed: 8000, clockwise: true, comment: "6mm flat", coolant: 1};
const bit = {number: 3, speed: 2500, clockwise: true, comment: "4mm drill", coolant: 2,
  lengthOffset: 3};

engine.onOpen();

// A slot with a ramp into it in the ZX plane, twice around a ring.
begin(mill, "Ring", new Vector(20, 0, 15), 1);
rapid(20, 0, 5);
line(20, 0, 1, 500);
arc(false, [0, 0, 1], [-20, 0, 0], 600);
arc(false, [0, 0, 0], [20, 0, -1], 600);
arc(false, [0, 0, -1], [20, 0, -1], 600);
arc(true, [23, 0, -1], [26, 0, -1], 600, 1);
line(30, 0, -1, 600);
engine.onDwell(0.5);
rapid(30, 0, 15);
end();

// The outline with round corners.
begin(mill, "Outline", new Vector(-40, -25, 15), 1);
rapid(-40, -25, 2);
for (const depth of [-1, -2]) {
  line(-40, -25, depth, 200);
  line(-34, -25, depth, 600);
  line(30, -25, depth, 600);
  arc(false, [30, -20, depth], [35, -20, depth], 600);
  line(35, 20, depth, 600);
  arc(false, [30, 20, depth], [30, 25, depth], 600);
  line(-30, 25, depth, 600);
  arc(false, [-30, 20, depth], [-35, 20, depth], 600);
  line(-35, -20, depth, 600);
  arc(false, [-30, -20, depth], [-30, -25, depth], 600);
  rapid(-30, -25, 2);
  rapid(-40, -25, 2);
}
rapid(-40, -25, 15);
end();

begin(bit, "Holes", new Vector(-28, -18, 15), 1);
const corners = [[-28, -18], [28, -18], [28, 18], [-28, 18]];
drill("deep-drilling", {retract: 3, feedrate: 150, incrementalDepth: 2, dwell: 0},
  corners.map(([x, y]) => [x, y, -8]));
drill("drilling", {retract: 3, feedrate: 200, dwell: 0}, [[0, 0, -3]]);
rapid(0, 0, 15);
end();
engine.onClose();

process.stdout.write(lines.join("\n") + "\n");
