//! `onescan-bindgen MODULE DIRECTORY`: what `wasm-bindgen --target web` does, in a tenth of the time
//! it takes to install that.

use std::process::ExitCode;
use wasm_bindgen_cli_support::Bindgen;

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [module, directory] = &arguments[..] else {
        eprintln!("usage: onescan-bindgen MODULE DIRECTORY");
        return ExitCode::from(2);
    };
    let mut bindgen = Bindgen::new();
    let web = bindgen.input_path(module).typescript(true).remove_name_section(true).web(true);
    match web.and_then(|web| web.generate(directory)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("onescan-bindgen: {error:#}");
            ExitCode::FAILURE
        }
    }
}
