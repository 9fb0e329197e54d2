//! The agreement of a command with a board, with its messages on standard error.

use super::CliError;
use haptimill_client::board::{Chosen, Need};
use haptimill_client::session::{Line, Session};
use haptimill_machine_file::MachineFile;

/// As [`Chosen::agree`]; prints the notices of the session.
///
/// # Errors
/// As [`Chosen::agree`].
pub(super) fn agree<L: Line>(
    chosen: &Chosen,
    session: &mut Session<L>,
    need: Need,
) -> Result<(), CliError> {
    let agreed = chosen.agree(session, need);
    print_notices(session);
    agreed?;
    Ok(())
}

/// As [`Chosen::file_of`]; prints the notices of the session.
///
/// # Errors
/// As [`Chosen::file_of`].
pub(super) fn file_of<L: Line>(
    chosen: &Chosen,
    session: &mut Session<L>,
) -> Result<MachineFile, CliError> {
    let file = chosen.file_of(session);
    print_notices(session);
    Ok(file?)
}

fn print_notices<L: Line>(session: &mut Session<L>) {
    while let Some(notice) = session.next_notice() {
        eprintln!("{notice}");
    }
}
