//! The program `mambavitact`.

use std::process::ExitCode;

fn main() -> ExitCode {
    ExitCode::from(mambavitact::main(std::env::args_os()))
}
