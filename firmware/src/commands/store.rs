//! The active configuration in the memory of the board, and the one that is active after a reset.

use super::conditions::Done;
use super::install;
use crate::comm::server::Server;
use crate::core::{Core, Storing};
use crate::io::{Inputs, Storage};
use crate::kept;
use haptimill_protocol::frame::crc32;
use haptimill_protocol::message::{InputProblem, Kept, Refusal};

/// Refuses while the board is keeping a configuration: it may not run the code that activates one,
/// and the drives stay off.
pub(super) fn not_storing(core: &Core) -> Done {
    match core.job.storing {
        Some(_) => Err(Refusal::Storing),
        None => Ok(()),
    }
}

/// Orders that the board keeps the staged configuration, which is the active one.
#[cold]
#[inline(never)]
pub(super) fn store(
    core: &mut Core,
    server: &Server,
    inputs: &Inputs,
    id: u8,
    staged: (u16, u32),
) -> Done {
    if core.safety.drives_on() {
        return Err(Refusal::DrivesOn);
    }
    not_storing(core)?;
    let machine = core.machine.as_ref().ok_or(Refusal::NotConfigured)?;
    match inputs.storage {
        Storage::None => return Err(Refusal::NoStorage),
        Storage::Busy => return Err(Refusal::Storing),
        Storage::Ready | Storage::Stored | Storage::Failed => {}
    }
    if !machine.is_at_standstill() {
        return Err(Refusal::Input(InputProblem::Coasting));
    }
    let (length, crc) = staged;
    let bytes = server.staged();
    if bytes.len() != usize::from(length) || crc32(bytes) != crc {
        return Err(Refusal::ConfigCheck);
    }
    if machine.crc != crc {
        return Err(Refusal::NotActive);
    }
    core.job.storing = Some(Storing {
        id: Some(id),
        crc,
        is_new: true,
    });
    Ok(())
}

/// Answers the order when the board has carried it out.
#[cold]
#[inline(never)]
pub(crate) fn follow(core: &mut Core, server: &mut Server, inputs: &Inputs) {
    let Some(storing) = &mut core.job.storing else {
        return;
    };
    storing.is_new = false;
    if inputs.storage == Storage::Busy || !server.can_answer() {
        return;
    }
    let Storing { id, crc, .. } = *storing;
    core.job.storing = None;
    let result = match inputs.storage {
        Storage::Stored => Ok(()),
        _ => Err(Refusal::StorageFailed),
    };
    if result.is_ok() {
        core.kept = Kept::Config(crc);
    }
    if let Some(id) = id {
        server.answer(id, result);
    }
}

/// Activates what a board keeps, before its first period. A board without any starts as one that
/// waits for a machine file.
#[cold]
#[inline(never)]
pub(crate) fn restore(core: &mut Core, kept: Option<&[u8]>) {
    core.kept = match kept.map(kept::configuration) {
        None => Kept::Nothing,
        Some(None) => Kept::OtherVersion,
        Some(Some(config)) => {
            let crc = crc32(config);
            match install(core, config, crc, &Inputs::default(), false) {
                Ok(()) => Kept::Config(crc),
                Err(refusal) => Kept::Refused(refusal),
            }
        }
    };
    #[cfg(feature = "defmt")]
    defmt::info!("kept configuration: {}", core.kept);
}
