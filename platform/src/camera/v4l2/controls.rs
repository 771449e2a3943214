//! Controls by name: exposure, gain and whatever else the driver has.
//!
//! In: names as `v4l2-ctl` writes them, and values. Invariant: a value is inside the driver's range before it is set. Switches and
//! menus are set before numbers, for `auto_exposure` decides whether an exposure time may be set at all.

use rustix::io::Errno;

use super::error::{OpenError, Trouble};
use super::node::{Control, ControlKind, Node};
use super::request::Request;
use crate::bad_input::closest;
use crate::config::ControlValue;

/// Controls looked through at most: drivers have dozens, and a driver that goes round in circles must not keep us.
const MOST: usize = 512;

/// Items of a menu looked through at most.
const MOST_ITEMS: i64 = 256;

/// Names listed where one is not known.
const LISTED: usize = 12;

/// What is wrong with a control, and its fix.
type Problem = (String, String);

/// Sets every configured control.
pub(super) fn apply(node: &mut impl Node, request: &Request) -> Result<(), Trouble> {
    if request.controls.is_empty() {
        return Ok(());
    }
    let known = list(node)?;
    let mut numbers = Vec::with_capacity(request.controls.len());
    for (name, value) in &request.controls {
        let wrong = |(problem, fix): Problem| {
            Trouble::Wrong(OpenError::Control {
                device: request.device.clone(),
                name: name.clone(),
                problem,
                fix,
            })
        };
        let control = find(&known, name).map_err(wrong)?;
        let number = number_of(node, control, value)?.map_err(wrong)?;
        numbers.push((control, number, name));
    }
    numbers.sort_by_key(|(control, ..)| control.kind == ControlKind::Integer);
    for (control, number, name) in numbers {
        match node.set_control(control.id, number) {
            Err(refused @ (Errno::INVAL | Errno::RANGE | Errno::ACCESS)) => {
                return Err(Trouble::Wrong(OpenError::Control {
                    device: request.device.clone(),
                    name: name.clone(),
                    problem: format!("the driver refuses {number} ({refused})"),
                    fix: "it may belong to a mode: set the automatic control that rules it to manual"
                        .to_owned(),
                }));
            }
            other => other?,
        }
    }
    Ok(())
}

/// All controls of the device.
fn list(node: &mut impl Node) -> Result<Vec<Control>, Errno> {
    let mut known = Vec::new();
    let mut id = 0;
    while known.len() < MOST {
        match node.control_after(id) {
            // The end; and a device without any.
            Err(Errno::INVAL | Errno::NOTTY) => break,
            other => {
                let control = other?;
                id = control.id;
                known.push(control);
            }
        }
    }
    Ok(known)
}

fn find<'a>(known: &'a [Control], name: &str) -> Result<&'a Control, Problem> {
    if let Some(control) = known.iter().find(|control| plain(&control.name) == name) {
        return if is_offered(control) {
            Ok(control)
        } else {
            Err((
                "it cannot be written".to_owned(),
                "remove it from controls of [camera.device]".to_owned(),
            ))
        };
    }
    let names: Vec<String> = (known.iter().filter(|control| is_offered(control)))
        .map(|control| plain(&control.name))
        .collect();
    let hint = closest(name, names.iter().map(String::as_str))
        .map_or_else(String::new, |meant| format!("did you mean `{meant}`? "));
    let rest = names.len().saturating_sub(LISTED);
    let more = if rest > 0 {
        format!(" and {rest} more, see `v4l2-ctl --list-ctrls`")
    } else {
        String::new()
    };
    let first = &names[..names.len().min(LISTED)];
    Err((
        "the device has none of that name".to_owned(),
        format!("{hint}it has: {}{more}", first.join(", ")),
    ))
}

fn is_offered(control: &Control) -> bool {
    control.is_writable && control.kind != ControlKind::Other
}

/// A name as `v4l2-ctl` writes it: small letters and digits, one underscore for all that lies between.
fn plain(name: &str) -> String {
    let mut words = String::with_capacity(name.len());
    let mut is_gap = false;
    for letter in name.chars() {
        if letter.is_ascii_alphanumeric() {
            if is_gap && !words.is_empty() {
                words.push('_');
            }
            words.push(letter.to_ascii_lowercase());
        }
        is_gap = !letter.is_ascii_alphanumeric();
    }
    words
}

/// The number that stands for a value; the outer error is the device's.
fn number_of(
    node: &mut impl Node,
    control: &Control,
    value: &ControlValue,
) -> Result<Result<i32, Problem>, Errno> {
    let number = match value {
        ControlValue::Bool(is_on) if control.kind == ControlKind::Bool => i64::from(*is_on),
        ControlValue::Integer(number) => *number,
        ControlValue::Item(name) if control.kind == ControlKind::Menu => {
            return item(node, control, name);
        }
        ControlValue::Bool(_) | ControlValue::Item(_) => {
            return Ok(Err(out_of_range(control, value)));
        }
    };
    let offset = number.wrapping_sub(control.minimum).cast_unsigned();
    let is_inside = (control.minimum..=control.maximum).contains(&number);
    let fits = is_inside && offset.is_multiple_of(control.step.max(1));
    let is_menu = matches!(control.kind, ControlKind::Menu | ControlKind::NumberMenu);
    let number = match i32::try_from(number) {
        Ok(number) if fits => number,
        _ => return Ok(Err(out_of_range(control, value))),
    };
    if is_menu {
        // Drivers leave numbers out of their menus.
        match node.menu_item(control, number.cast_unsigned()) {
            Err(Errno::INVAL) => return Ok(Err(menu_problem(node, control, value)?)),
            other => drop(other?),
        }
    }
    Ok(Ok(number))
}

/// The number of a menu's item by its name.
fn item(node: &mut impl Node, control: &Control, name: &str) -> Result<Result<i32, Problem>, Errno> {
    let found =
        (items(node, control)?.into_iter()).find(|(_, item)| item == name || plain(item) == plain(name));
    Ok(match found {
        Some((number, _)) => Ok(number),
        None => Err(menu_problem(node, control, &ControlValue::Item(name.to_owned()))?),
    })
}

fn items(node: &mut impl Node, control: &Control) -> Result<Vec<(i32, String)>, Errno> {
    let mut items = Vec::new();
    let last = control.maximum.min(control.minimum.saturating_add(MOST_ITEMS));
    for number in control.minimum..=last {
        let Ok(number) = i32::try_from(number) else {
            break;
        };
        match node.menu_item(control, number.cast_unsigned()) {
            Err(Errno::INVAL) => {}
            other => items.push((number, other?)),
        }
    }
    Ok(items)
}

fn menu_problem(node: &mut impl Node, control: &Control, value: &ControlValue) -> Result<Problem, Errno> {
    let items: Vec<String> = (items(node, control)?.into_iter())
        .map(|(number, name)| format!("{number} \"{name}\""))
        .collect();
    Ok((
        format!("{value} is not in its menu"),
        format!("use one of: {}", items.join(", ")),
    ))
}

fn out_of_range(control: &Control, value: &ControlValue) -> Problem {
    let fix = match control.kind {
        ControlKind::Bool => "use true or false".to_owned(),
        _ => format!(
            "use a whole number from {} to {} in steps of {}",
            control.minimum,
            control.maximum,
            control.step.max(1)
        ),
    };
    (format!("{value} is no value of it"), fix)
}

#[cfg(test)]
mod tests {
    #[test]
    fn names_are_those_of_v4l2_ctl() {
        for (name, plain) in [
            ("Exposure, Dynamic Framerate", "exposure_dynamic_framerate"),
            ("White Balance, Automatic", "white_balance_automatic"),
            ("Gain", "gain"),
            ("S-Min/S-Max (%)", "s_min_s_max"),
        ] {
            assert_eq!(super::plain(name), plain);
        }
    }
}
