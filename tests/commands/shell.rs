//! `completions` and `man`.

use std::fs;

use crate::workplace::Workplace;

#[test]
fn shells_and_man_know_the_commands() {
    let workplace = Workplace::new();
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        let text = workplace.run(&format!("completions {shell}")).good();
        assert!(text.contains("mambavitact") && text.contains("modality"), "{shell}");
    }
    assert!(workplace.run("completions tcsh").usage().contains("zsh"));
    workplace.run("man --out pages").good();
    let page = |name: &str| fs::read_to_string(workplace.path("pages").join(name)).unwrap();
    assert!(page("mambavitact.1").contains("mambavitact\\-run(1)"));
    assert!(page("mambavitact-run.1").contains("modality"));
    assert!(page("mambavitact-touch-data.1").contains("images"));
    // Hidden names have no page.
    assert!(!workplace.path("pages/mambavitact-contacts.1").exists());
}
