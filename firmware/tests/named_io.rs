//! Named inputs and outputs: filter and latch against a reference, configuration, words of a board.

use haptimill_firmware::io::Inputs;
use haptimill_firmware::named_io::config::{
    AnalogOutputConfig, ContactReaction, InputConfig, InputFunction, IoConfig, OutputConfig,
    OutputFunction,
};
use haptimill_firmware::named_io::{NamedIo, ProbeLatch, Probing};
use haptimill_protocol::message::{ConfigField, Refusal};
use proptest::prelude::*;

fn input(function: InputFunction, channel: u8, inverted: bool, filter: u16) -> InputConfig {
    InputConfig {
        function,
        channel,
        inverted,
        filter,
    }
}

fn output(function: OutputFunction, channel: u8, safe: bool) -> OutputConfig {
    OutputConfig {
        function,
        channel,
        inverted: false,
        safe,
        safe_without_host: true,
    }
}

/// Levels of an input by definition: a level counts once it has been there for the filter and one
/// period more. Returns them, and for each period the start of the run of equal levels.
fn reference(raw: &[bool], filter: u16) -> (Vec<bool>, Vec<usize>) {
    let mut level = raw[0];
    let (mut levels, mut starts) = (Vec::new(), Vec::new());
    for (at, now) in raw.iter().enumerate() {
        let run = raw[..=at]
            .iter()
            .rev()
            .take_while(|old| *old == now)
            .count();
        if run > usize::from(filter) {
            level = *now;
        }
        levels.push(level);
        starts.push(at + 1 - run);
    }
    (levels, starts)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, rng_seed: proptest::test_runner::RngSeed::Fixed(18), failure_persistence: None, ..ProptestConfig::default() })]

    /// Filtered levels equal their definition, whatever the other channels do. The latch holds the
    /// period in which the level began to stay.
    #[test]
    fn filter_and_latch_equal_their_definition(
        runs in prop::collection::vec(1_usize..9, 2..40),
        noise in prop::collection::vec(any::<u32>(), 400),
        filter in 0_u16..7, channel in 0_u8..32, inverted: bool, first: bool, contact: bool,
    ) {
        let mut raw = vec![first];
        for run in runs {
            let next = !raw[raw.len() - 1];
            raw.extend(std::iter::repeat_n(next, run));
        }
        let probe = InputFunction::Probe(ContactReaction::Fault);
        let mut config = IoConfig::default();
        let other = (channel + 5) % 32;
        config.inputs.push(input(InputFunction::General, other, false, 3)).unwrap();
        config.inputs.push(input(probe, channel, inverted, filter)).unwrap();
        prop_assert_eq!(config.check(), Ok(()));
        let (levels, starts) = reference(&raw, filter);
        let mut io = NamedIo::new(&config);
        let mut armed = false;
        for (period, active) in raw.iter().enumerate() {
            let bit = 1 << channel;
            let word = noise[period] & !bit | if *active != inverted { bit } else { 0 };
            let inputs = Inputs { digital: word, ..Inputs::default() };
            let here = |period| ProbeLatch { period, ..ProbeLatch::default() };
            io.measure(&config, &inputs, || here(period as u64));
            prop_assert_eq!(io.is_active(1), levels[period], "period {}", period);
            let changed = period > 0 && levels[period] != levels[period - 1];
            prop_assert_eq!(io.changed() & 2 != 0, changed);
            if !armed && levels[period] != contact && *active != contact {
                let probing = Probing { input: 1, active: contact };
                io.arm(&config, probing, here(9_999)).unwrap();
                armed = true;
            } else if armed && levels[period] == contact {
                prop_assert!(io.is_at_contact());
                prop_assert_eq!(io.latch().period, starts[period] as u64);
                io.take_probing();
                armed = false;
            }
        }
    }

    /// Two entries of one channel, or of one function but `General`, are refused; others are not.
    #[test]
    fn duplicates_are_refused(channels in prop::collection::vec(0_u8..40, 1..16), functions in prop::collection::vec(0_usize..6, 16)) {
        use OutputFunction as F;
        let all = [F::General, F::Coolant, F::Mist, F::ToolClamp, F::SpindleOn, F::SpindleReverse];
        let mut config = IoConfig::default();
        for (channel, function) in channels.iter().zip(&functions) {
            let function = all[*function];
            config.outputs.push(output(function, *channel, function == F::ToolClamp)).unwrap();
        }
        let repeated = |list: &[usize]| (1..list.len()).any(|at| list[..at].contains(&list[at]));
        let named: Vec<usize> = functions.iter().copied().take(channels.len()).filter(|it| *it != 0).collect();
        let places: Vec<usize> = channels.iter().map(|channel| usize::from(*channel)).collect();
        let wrong = repeated(&named) || repeated(&places) || places.iter().any(|place| *place > 31);
        let problem = config.check().err().map(|problem| problem.field);
        prop_assert_eq!(problem, wrong.then_some(ConfigField::Output));
    }

    /// Safe values: all of them, or those that a silent host concerns.
    #[test]
    fn safe_values_are_those_of_the_configuration(
        entries in prop::collection::vec((any::<bool>(), any::<bool>(), any::<bool>()), 1..16),
        codes in prop::collection::vec((-100_i16..100, any::<bool>(), -100_i16..100), 0..4), all: bool,
    ) {
        let mut config = IoConfig::default();
        for (channel, (safe, keep, _)) in entries.iter().enumerate() {
            let output = output(OutputFunction::General, channel as u8, *safe);
            config.outputs.push(OutputConfig { safe_without_host: !keep, ..output }).unwrap();
        }
        for (channel, (safe, keep, _)) in codes.iter().enumerate() {
            config.analog_outputs.push(AnalogOutputConfig { channel: channel as u8, low: -100, high: 100, safe: *safe, safe_without_host: !keep }).unwrap();
        }
        prop_assert_eq!(config.check(), Ok(()));
        let mut io = NamedIo::new(&config);
        prop_assert!(entries.iter().enumerate().all(|(at, it)| (io.outputs() >> at & 1 != 0) == it.0));
        for (index, (_, _, on)) in entries.iter().enumerate() {
            prop_assert_eq!(io.may_set(&config, index as u8, 500), Ok(()));
            io.set(index as u8, *on);
        }
        for (index, (_, _, code)) in codes.iter().enumerate() {
            prop_assert_eq!(NamedIo::may_set_analog(&config, index as u8, *code), Ok(()));
            io.set_analog(index as u8, *code);
        }
        let refused = matches!(NamedIo::may_set_analog(&config, 0, 101), Err(Refusal::AnalogOutput { .. }));
        prop_assert!(refused);
        io.make_safe(&config, all);
        for (index, (safe, keep, on)) in entries.iter().enumerate() {
            let expected = if all || !keep { *safe } else { *on };
            prop_assert_eq!(io.outputs() >> index & 1 != 0, expected);
        }
        for (index, (safe, keep, code)) in codes.iter().enumerate() {
            prop_assert_eq!(io.analog_output(index), if all || !keep { *safe } else { *code });
        }
    }
}
