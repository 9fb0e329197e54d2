//! Whole-system tests of Haptimill live in `tests/tests`; this library holds what they share.
