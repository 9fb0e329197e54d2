//! Keys of the named inputs and outputs.

use crate::key::sections;

sections! {

input "input" "A digital input, at most 16. A probe or tool setter latches the position of its contact." {
    name = text("1 to 24 letters, digits, - and _").is("name in commands, messages and columns")
        .bounded("different from every other input and output");
    function = word(&["general", "probe", "tool_setter", "feed_hold", "door"])
        .is("what the controller does with it; each but `general` once");
    channel = whole(0, 31, "").is("channel of the board").bounded("each once");
    active = word(&["high", "low"]).is("level at which the input is active; a door is open then")
        .or_text("\"high\"");
    filter_ms = real(0.0, 1000.0, "ms")
        .is("a new level counts after this time; the latch of a probe does not wait for it")
        .or_text("0 for a probe or tool setter, else 2");
    contact = word(&["fault", "warning"])
        .is("reaction to a contact in motion while no probing is armed").or_text("\"fault\"")
        .only("function = \"probe\" or \"tool_setter\"");
    run_up_s = real(0.0, 60.0, "s")
        .is("run-up time of the spindle: from its restart to the motion of a job that an open door held")
        .only_if("function", "door").bounded("at most 60,000 control periods");
}

output "output" "A digital output, at most 16." {
    name = text("1 to 24 letters, digits, - and _").is("name in commands, messages and columns")
        .bounded("different from every other input and output");
    function = word(&["general", "coolant", "mist", "tool_clamp", "spindle_on", "spindle_reverse"])
        .is("what the controller does with it; each but `general` once");
    channel = whole(0, 31, "").is("channel of the board").bounded("each once");
    active = word(&["high", "low"]).is("level at which the output is on").or_text("\"high\"");
    safe = word(&["off", "on"]).is("value in a fault, in an emergency stop and after configuration")
        .bounded("off for an output that follows the spindle, on for a tool clamp");
    without_host = word(&["safe", "keep"])
        .is("value while nothing is received from the host for `heartbeat_ms`")
        .or_text("\"safe\"");
}

analog_input "analog_input" "An analog input, at most 4." {
    name = text("1 to 24 letters, digits, - and _").is("name in messages and columns")
        .bounded("different from every other input and output");
    channel = whole(0, 3, "").is("channel of the board").bounded("each once");
    unit = text("a unit").is("unit of its values, for messages").or_text("none");
    full_scale = real(-1e9, 1e9, "").is("value of the code 32768").bounded("not 0");
}

analog_output "analog_output" "An analog output, at most 4." {
    name = text("1 to 24 letters, digits, - and _").is("name in commands, messages and columns")
        .bounded("different from every other input and output");
    channel = whole(0, 3, "").is("channel of the board").bounded("each once");
    unit = text("a unit").is("unit of its values, for messages").or_text("none");
    full_scale = real(-1e9, 1e9, "").is("value of the code 32768").bounded("not 0");
    low = real(-1e9, 1e9, "").is("smallest value").or_text("that of the codes")
        .bounded("within the codes -32768 to 32767");
    high = real(-1e9, 1e9, "").is("largest value").or_text("that of the codes")
        .bounded("within the codes -32768 to 32767");
    safe = real(-1e9, 1e9, "")
        .is("value in a fault, in an emergency stop and after configuration")
        .bounded("`low` to `high`");
    without_host = word(&["safe", "keep"])
        .is("value while nothing is received from the host for `heartbeat_ms`")
        .or_text("\"safe\"");
}

}
