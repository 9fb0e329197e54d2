// Post-processor for Autodesk Fusion (milling, 3 axes).
//
// In Fusion: Manufacture, Post Process, choose this file. Properties: useToolLength writes G43 with
// each tool, which needs a tool table beside the machine file; sequenceNumbers writes N words.

description = "Haptimill";
vendor = "Haptimill";
certificationLevel = 2;
minimumRevision = 45702;
longDescription = "Milling in three axes for Haptimill (RS274/NGC).";
extension = "ngc";
setCodePage("ascii");
capabilities = CAPABILITY_MILLING;
tolerance = spatial(0.002, MM);
minimumChordLength = spatial(0.25, MM);
minimumCircularRadius = spatial(0.01, MM);
maximumCircularRadius = spatial(1000, MM);
minimumCircularSweep = toRad(0.01);
maximumCircularSweep = toRad(360);
allowHelicalMoves = true;
allowedCircularPlanes = undefined; // all three planes

properties = {
  useToolLength: true,
  sequenceNumbers: false
};

var gFormat = createFormat({prefix: "G", decimals: 1});
var mFormat = createFormat({prefix: "M", decimals: 0});
var xyzFormat = createFormat({decimals: unit == MM ? 4 : 5, forceDecimal: true});
var feedFormat = createFormat({decimals: unit == MM ? 1 : 2, forceDecimal: true});
var secFormat = createFormat({decimals: 3, forceDecimal: true});
var wholeFormat = createFormat({decimals: 0});

var xOutput = createVariable({prefix: "X"}, xyzFormat);
var yOutput = createVariable({prefix: "Y"}, xyzFormat);
var zOutput = createVariable({prefix: "Z"}, xyzFormat);
var feedOutput = createVariable({prefix: "F"}, feedFormat);
var iOutput = createReferenceVariable({prefix: "I", force: true}, xyzFormat);
var jOutput = createReferenceVariable({prefix: "J", force: true}, xyzFormat);
var kOutput = createReferenceVariable({prefix: "K", force: true}, xyzFormat);
var gMotionModal = createModal({}, gFormat);
var gPlaneModal = createModal({onchange: function () { gMotionModal.reset(); }}, gFormat);

var sequenceNumber = 0;

function writeBlock() {
  var text = formatWords(arguments);
  if (!text) {
    return;
  }
  if (properties.sequenceNumbers) {
    sequenceNumber += 5;
    text = "N" + sequenceNumber + " " + text;
  }
  writeln(text);
}

function writeComment(text) {
  writeln("(" + String(text).replace(/[()\r\n]/g, " ") + ")");
}

function forceXYZ() {
  xOutput.reset();
  yOutput.reset();
  zOutput.reset();
}

function onOpen() {
  if (programName) {
    writeComment(programName);
  }
  if (programComment) {
    writeComment(programComment);
  }
  writeBlock(gFormat.format(90), gFormat.format(94), gFormat.format(91.1), gFormat.format(40),
    gFormat.format(49), gPlaneModal.format(17));
  writeBlock(gFormat.format(unit == IN ? 20 : 21));
  writeBlock(gFormat.format(64), "P" + xyzFormat.format(unit == MM ? 0.02 : 0.0008));
}

function onComment(text) {
  writeComment(text);
}

function onSection() {
  var changesTool = isFirstSection() || tool.number != getPreviousSection().getTool().number;
  if (hasParameter("operation-comment")) {
    writeComment(getParameter("operation-comment"));
  }
  if (!isSameDirection(currentSection.workPlane.forward, new Vector(0, 0, 1))) {
    error("The tool axis is tilted; this post-processor is for three axes.");
    return;
  }
  if (changesTool) {
    if (!isFirstSection()) {
      onCommand(COMMAND_COOLANT_OFF);
      writeBlock(mFormat.format(5));
    }
    if (tool.comment) {
      writeComment(tool.comment);
    }
    writeBlock("T" + wholeFormat.format(tool.number), mFormat.format(6));
  }
  writeBlock("S" + wholeFormat.format(spindleSpeed), mFormat.format(tool.clockwise ? 3 : 4));
  // G54 to G59, G59.1 to G59.3; 0 is the default.
  var offset = currentSection.workOffset || 1;
  if (offset > 9) {
    error("Work offset " + offset + " does not exist; choose 1 to 9.");
    return;
  }
  writeBlock(gFormat.format(offset <= 6 ? 53 + offset : 59 + (offset - 6) / 10));
  if (tool.coolant == COOLANT_MIST) {
    writeBlock(mFormat.format(7));
  } else if (tool.coolant && tool.coolant != COOLANT_OFF) {
    writeBlock(mFormat.format(8));
  }
  setRotation(currentSection.workPlane);
  forceXYZ();
  feedOutput.reset();
  gMotionModal.reset();
  var start = getFramePosition(currentSection.getInitialPosition());
  if (properties.useToolLength && changesTool) {
    writeBlock(gFormat.format(43), "H" + wholeFormat.format(tool.lengthOffset || tool.number));
  }
  writeBlock(gMotionModal.format(0), zOutput.format(start.z));
  writeBlock(gMotionModal.format(0), xOutput.format(start.x), yOutput.format(start.y));
}

function onSpindleSpeed(speed) {
  writeBlock("S" + wholeFormat.format(speed));
}

function onDwell(seconds) {
  writeBlock(gFormat.format(4), "P" + secFormat.format(seconds));
}

function onRadiusCompensation() {
  if (radiusCompensation != RADIUS_COMPENSATION_OFF) {
    error("Choose the compensation type 'In computer'.");
  }
}

function onRapid(_x, _y, _z) {
  var x = xOutput.format(_x), y = yOutput.format(_y), z = zOutput.format(_z);
  if (x || y || z) {
    writeBlock(gMotionModal.format(0), x, y, z);
    feedOutput.reset();
  }
}

function onLinear(_x, _y, _z, feed) {
  var x = xOutput.format(_x), y = yOutput.format(_y), z = zOutput.format(_z);
  if (x || y || z) {
    writeBlock(gMotionModal.format(1), x, y, z, feedOutput.format(feed));
  }
}

function onCircular(clockwise, cx, cy, cz, x, y, z, feed) {
  var start = getCurrentPosition();
  var code = clockwise ? 2 : 3;
  var i = iOutput.format(cx - start.x, 0), j = jOutput.format(cy - start.y, 0);
  var k = kOutput.format(cz - start.z, 0);
  var words;
  switch (getCircularPlane()) {
  case PLANE_XY:
    words = [gPlaneModal.format(17), i, j];
    break;
  case PLANE_ZX:
    words = [gPlaneModal.format(18), i, k];
    break;
  case PLANE_YZ:
    words = [gPlaneModal.format(19), j, k];
    break;
  default:
    linearize(tolerance);
    return;
  }
  // A full circle has no end point.
  var end = isFullCircle() ? ["", "", ""] : [xOutput.format(x), yOutput.format(y), zOutput.format(z)];
  writeBlock(words[0], gMotionModal.format(code), end[0], end[1], end[2], words[1], words[2],
    feedOutput.format(feed));
}

function onCycle() {
  writeBlock(gPlaneModal.format(17));
}

function onCyclePoint(x, y, z) {
  if (!isFirstCyclePoint()) {
    writeBlock(xOutput.format(x), yOutput.format(y));
    return;
  }
  forceXYZ();
  var common = [gFormat.format(98), null, xOutput.format(x), yOutput.format(y), zOutput.format(z),
    "R" + xyzFormat.format(cycle.retract)];
  var feed = feedOutput.format(cycle.feedrate);
  var dwell = cycle.dwell ? "P" + secFormat.format(cycle.dwell / 1000) : "";
  switch (cycleType) {
  case "drilling":
    common[1] = gFormat.format(81);
    break;
  case "counter-boring":
    common[1] = gFormat.format(dwell ? 82 : 81);
    common.push(dwell);
    break;
  case "chip-breaking":
    common[1] = gFormat.format(73);
    common.push("Q" + xyzFormat.format(cycle.incrementalDepth));
    break;
  case "deep-drilling":
    common[1] = gFormat.format(83);
    common.push("Q" + xyzFormat.format(cycle.incrementalDepth));
    break;
  case "reaming":
  case "boring":
    common[1] = gFormat.format(dwell ? 89 : 85);
    common.push(dwell);
    break;
  default:
    expandCyclePoint(x, y, z);
    return;
  }
  writeBlock(common, feed);
}

function onCycleEnd() {
  if (!cycleExpanded) {
    writeBlock(gFormat.format(80));
    gMotionModal.reset();
    zOutput.reset();
  }
}

function onCommand(command) {
  switch (command) {
  case COMMAND_STOP:
    writeBlock(mFormat.format(0));
    return;
  case COMMAND_OPTIONAL_STOP:
    writeBlock(mFormat.format(1));
    return;
  case COMMAND_COOLANT_OFF:
    writeBlock(mFormat.format(9));
    return;
  case COMMAND_STOP_SPINDLE:
    writeBlock(mFormat.format(5));
    return;
  }
}

function onSectionEnd() {
  writeBlock(gPlaneModal.format(17));
  forceXYZ();
}

function onClose() {
  onCommand(COMMAND_COOLANT_OFF);
  writeBlock(mFormat.format(5));
  writeBlock(mFormat.format(30));
}
