//! The program `mambavitact` whose command `touch train` can use an NVIDIA GPU.

use std::process::ExitCode;

fn main() -> ExitCode {
    mambavitact_gpu::cuda::GPU.bring();
    ExitCode::from(mambavitact::main(std::env::args_os()))
}
