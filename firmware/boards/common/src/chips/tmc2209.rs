//! The one-wire UART of up to four TMC2209.

use super::{DriveBus, Failure, currents, of_trouble};
use embedded_hal_nb::serial::{Read, Write};
use haptimill_drivers::tmc2209::{Bus, Error, Settings};
use haptimill_firmware::config::DriveChip;
use haptimill_protocol::message::DriveAlarm;

impl<S, C, E> DriveBus for Bus<S, C>
where
    S: Read<u8, Error = E> + Write<u8, Error = E>,
    C: FnMut() -> u32,
{
    async fn prepare(&mut self, _chips: usize) {
        // Each chip reports for itself whether it has taken its settings.
        let _ = self.separate_replies().await;
    }

    async fn configure(&mut self, chip: &DriveChip) -> Result<(), Failure> {
        let place = chip.place;
        let Ok(settings) = Settings::new(currents(chip), chip.microsteps) else {
            let alarm = DriveAlarm::NotSet;
            return Err(Failure { alarm, place });
        };
        let result = Bus::configure(self, place, &settings).await;
        result.map_err(|error| failure(place, error))
    }

    async fn trouble(&mut self, chip: &DriveChip) -> Result<Option<DriveAlarm>, Failure> {
        let place = chip.place;
        match Bus::trouble(self, place).await {
            Ok(trouble) => Ok(trouble.map(of_trouble)),
            Err(error) => Err(failure(place, error)),
        }
    }
}

/// Why the chip at a place that failed a command is not ready.
fn failure<E>(place: u8, error: Error<E>) -> Failure {
    let alarm = match error {
        Error::NoReply => DriveAlarm::Silent,
        Error::Serial(_) | Error::Echo | Error::Noise | Error::Check | Error::WrongReply => {
            DriveAlarm::Disturbed
        }
        Error::NotTaken | Error::ReadBack { .. } | Error::Version(_) => DriveAlarm::NotSet,
        Error::Trouble(trouble) => of_trouble(trouble),
    };
    Failure { alarm, place }
}
