//! The checks of the chip, in this process.

#[test]
fn all_checks_hold() {
    for check in haptimill_checks::all() {
        println!("check {}", check.name);
        (check.run)();
    }
}

#[test]
#[should_panic(expected = "two and two")]
fn the_check_that_fails_fails() {
    (haptimill_checks::FAILING.run)();
}

#[test]
fn every_check_has_a_name_of_its_own() {
    let names: std::collections::BTreeSet<_> =
        haptimill_checks::all().map(|check| check.name).collect();
    assert_eq!(names.len(), haptimill_checks::all().count());
    assert!(!names.contains(haptimill_checks::FAILING.name));
}
