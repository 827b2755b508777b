//! Tests of warnings about what is allowed and of no effect.

use super::*;

#[test]
fn attributes_that_others_make_ineffective_are_named() {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let text = std::fs::read_to_string(root.join("scenarios/intersection.xml")).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("a.xml");
    let changed = text.replacen("wreckTime=", "border=\"kerb\" wreckTime=", 1).replacen(
        "conflictStreams=",
        "foresight=\"4\" lidarRange=\"50\" conflictStreams=",
        1,
    );
    let idle = |text: &str| -> Vec<String> {
        std::fs::write(&file, text).unwrap();
        let messages = Scenario::check(&file).list.into_iter().map(|finding| finding.message);
        messages.filter(|message| message.contains("has no effect")).collect()
    };
    assert!(idle(&text).is_empty());
    let expected = [
        "foresight of <observation> has no effect, because encounters is 0",
        "border of <termination> has no effect, because vehicles do not steer",
    ];
    assert_eq!(idle(&changed), expected);
    // Without cooperation, agents share nothing, near or far.
    let near = text.replacen("<reward ", "<reward shareRange=\"50\" ", 1);
    assert!(idle(&near).is_empty());
    let alone = near.replacen("cooperation=\"0.06\"", "cooperation=\"0\"", 1);
    assert_eq!(idle(&alone), ["shareRange of <reward> has no effect, because cooperation is 0"]);
}
