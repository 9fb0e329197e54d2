//! The chain of up to five TMC5160 at an SPI.

use super::{DriveBus, Failure, currents, of_trouble};
use embedded_hal::digital::OutputPin;
use embedded_hal_nb::spi::FullDuplex;
use haptimill_drivers::tmc5160::{Chain, Error, Settings};
use haptimill_firmware::config::DriveChip;
use haptimill_protocol::message::DriveAlarm;

impl<S, P, E> DriveBus for Chain<S, P>
where
    S: FullDuplex<u8, Error = E>,
    P: OutputPin<Error = E>,
{
    async fn prepare(&mut self, chips: usize) {
        self.set_chips(chips);
    }

    async fn configure(&mut self, chip: &DriveChip) -> Result<(), Failure> {
        let place = chip.place;
        let Ok(settings) = Settings::new(currents(chip), chip.microsteps) else {
            let alarm = DriveAlarm::NotSet;
            return Err(Failure { alarm, place });
        };
        let result = Chain::configure(self, place, &settings).await;
        result.map_err(|error| failure(place, error))
    }

    async fn trouble(&mut self, chip: &DriveChip) -> Result<Option<DriveAlarm>, Failure> {
        let place = chip.place;
        match Chain::trouble(self, place).await {
            Ok(trouble) => Ok(trouble.map(of_trouble)),
            Err(error) => Err(failure(place, error)),
        }
    }
}

/// Why the chip at a place that failed a command is not ready.
fn failure<E>(place: u8, error: Error<E>) -> Failure {
    let alarm = match error {
        Error::NoReply(place) => {
            let alarm = DriveAlarm::Silent;
            return Failure { alarm, place };
        }
        Error::Spi(_) | Error::Length => DriveAlarm::Disturbed,
        Error::Version(_)
        | Error::NoStepInputs
        | Error::NotTaken { .. }
        | Error::ReadBack { .. } => DriveAlarm::NotSet,
        Error::Trouble(trouble) => of_trouble(trouble),
    };
    Failure { alarm, place }
}
