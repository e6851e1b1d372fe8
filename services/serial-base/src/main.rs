//! The plant process of a robot whose base is connected to a serial port.

use serial_base::SerialBase;
use std::process::ExitCode;

fn main() -> ExitCode {
    driver::main(SerialBase::open)
}
