//! A clock that stands still, so that no decision of a reproducible replay depends on the time it took.

use freespace::port::Clock;
use freespace::space::Micros;

/// Always the same instant.
#[derive(Clone, Copy, Debug, Default)]
pub struct FrozenClock(pub Micros);

impl Clock for FrozenClock {
    fn now(&self) -> Micros {
        self.0
    }
}
