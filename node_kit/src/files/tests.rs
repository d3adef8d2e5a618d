use super::*;
use std::{
    fs::Permissions,
    os::unix::fs::{PermissionsExt, symlink},
};
use tempfile::TempDir;
use test_support::place::names;

fn file(folder: &TempDir, name: &str, text: &str) -> PathBuf {
    let path = folder.path().join(name);
    fs::write(&path, text).unwrap();
    path
}

#[test]
fn text_is_read_and_an_endless_file_rejected() {
    let folder = tempfile::tempdir().unwrap();
    assert_eq!(read_text(&file(&folder, "a", "a: 1\n")).unwrap(), "a: 1\n");
    let path = folder.path().join("a");
    fs::write(&path, [0xFF, 0xFE]).unwrap();
    assert_eq!(read_text(&path).unwrap_err().kind(), ErrorKind::InvalidData);
    fs::remove_file(&path).unwrap();
    let missing = read_text(&path).unwrap_err();
    assert_eq!(missing.kind(), ErrorKind::NotFound);
    assert!(missing.to_string().contains("correct the path"), "{missing}");
    assert_eq!(read_text(Path::new("/dev/zero")).unwrap_err().kind(), ErrorKind::FileTooLarge);
}

#[test]
fn a_file_appears_when_it_is_complete() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("out");
    let mut output = OutputFile::create(&path, false).unwrap();
    output.write_all(b"new").unwrap();
    assert!(!path.exists());
    // Nothing else in this process writes it meanwhile, and a file that appears is not lost.
    assert!(OutputFile::create(&path, false).is_err());
    fs::write(&path, "of another").unwrap();
    assert!(matches!(output.commit(), Err(FileError::Exists { .. })));
    assert_eq!(
        (fs::read_to_string(&path).unwrap().as_str(), names(folder.path()).len()),
        ("of another", 1)
    );
    fs::remove_file(&path).unwrap();
    write(&path, b"new", false).unwrap();
    assert_eq!(
        (fs::read_to_string(&path).unwrap().as_str(), names(folder.path()).len()),
        ("new", 1)
    );
}

#[test]
fn an_existing_file_is_replaced_only_on_request_and_keeps_its_mode_and_links() {
    let folder = tempfile::tempdir().unwrap();
    let path = file(&folder, "out", "former");
    fs::set_permissions(&path, Permissions::from_mode(0o640)).unwrap();
    assert!(matches!(write(&path, b"new", false), Err(FileError::Exists { .. })));
    drop(OutputFile::create(&path, true).unwrap());
    assert_eq!(fs::read_to_string(&path).unwrap(), "former");
    let link = folder.path().join("link");
    symlink(&path, &link).unwrap();
    write(&link, b"new", true).unwrap();
    assert!(link.is_symlink());
    assert_eq!(fs::read_to_string(&path).unwrap(), "new");
    assert_eq!(fs::metadata(&path).unwrap().mode() & 0o777, 0o640);
    assert_eq!(names(folder.path()), ["link", "out"]);
    assert!(matches!(write(folder.path(), b"", true), Err(FileError::Folder { .. })));
    // A link to a file that is not there yet.
    fs::remove_file(&path).unwrap();
    write(&link, b"again", true).unwrap();
    assert!(link.is_symlink());
    assert_eq!(fs::read_to_string(&path).unwrap(), "again");
}

#[test]
fn an_input_is_found_under_any_name() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    fs::create_dir(&bag).unwrap();
    let member = bag.join("bag_0.mcap");
    fs::write(&member, "").unwrap();
    let (soft, hard) = (folder.path().join("soft"), folder.path().join("hard"));
    symlink(&member, &soft).unwrap();
    fs::hard_link(&member, &hard).unwrap();
    let dotted = bag.join("../bag/bag_0.mcap");
    for output in [&member, &soft, &hard, &dotted, &bag] {
        for input in [&bag, &member, &hard] {
            let checked = check_output(output, true, &[input]);
            let other = output == &bag && input != &bag;
            assert!(
                matches!(checked, Err(FileError::Input { .. })) != other,
                "{output:?} {input:?}: {checked:?}"
            );
        }
    }
    assert!(check_output(&bag.join("new.csv"), false, &[&bag]).is_ok());
    assert!(check_output(Path::new("/dev/null"), false, &[Path::new("/dev/null")]).is_ok());
}

#[test]
fn outputs_need_a_folder_and_names_of_their_own() {
    let folder = tempfile::tempdir().unwrap();
    let (a, b) = (folder.path().join("a"), folder.path().join("b"));
    let dotted = folder.path().join("./a");
    assert!(check_outputs(&[&a, &b], false, &[]).is_ok());
    assert!(
        check_outputs(
            &[Path::new("a"), Path::new("/dev/null"), Path::new("/dev/null")],
            false,
            &[]
        )
        .is_ok()
    );
    assert!(matches!(check_outputs(&[&a, &dotted], false, &[]), Err(FileError::Twice { .. })));
    file(&folder, "a", "text");
    symlink(&a, &b).unwrap();
    assert!(matches!(check_outputs(&[&a, &b], true, &[]), Err(FileError::Twice { .. })));
    assert!(matches!(check_outputs(&[&a], true, &[&a]), Err(FileError::Input { .. })));
    for nowhere in [folder.path().join("none/c"), a.join("c")] {
        let error = check_outputs(&[&nowhere], false, &[]).unwrap_err().to_string();
        assert!(error.contains("/c: cannot be written") && error.contains("folder"), "{error}");
    }
}

#[test]
fn a_full_disk_and_a_folder_that_is_not_there_are_named() {
    let error = write(Path::new("/dev/full"), b"text", false).unwrap_err().to_string();
    assert!(error.contains("/dev/full") && error.contains("space on the disk"), "{error}");
    let error = write(Path::new("/no/such/out"), b"", false).unwrap_err();
    assert!(error.to_string().contains("/no/such/out"), "{error}");
    // The message has the system's error; `{:#}` would repeat a source.
    assert!(std::error::Error::source(&error).is_none(), "{error}");
}

#[test]
fn what_another_process_of_the_same_number_left_stays_and_is_in_nobodys_way() {
    let folder = tempfile::tempdir().unwrap();
    let left = file(&folder, &format!("out.{}.partial", std::process::id()), "of another");
    write(&folder.path().join("out"), b"new", false).unwrap();
    assert_eq!(fs::read(left).unwrap(), b"of another");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2);
}
