//! The program `mambavitact`.

use std::process::ExitCode;

fn main() -> ExitCode {
    #[cfg(feature = "cuda")]
    mvt_cuda::bring_first_device();
    ExitCode::from(mambavitact::main(std::env::args_os()))
}
