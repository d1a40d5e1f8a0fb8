// The colors of the page, light or dark, from the variables of its style.

export interface Palette {
  paper: string;
  floor: string;
  ink: string;
  muted: string;
  line: string;
  trail: string;
  faint: string;
  obstacle: string;
  robot: string;
  robotEdge: string;
  person: string;
  member: string;
  none: string;
}

export function palette(element: Element): Palette {
  const style = getComputedStyle(element);
  const color = (name: string): string => style.getPropertyValue(`--${name}`).trim();
  return {
    paper: color("paper"),
    floor: color("floor"),
    ink: color("ink"),
    muted: color("muted"),
    line: color("line"),
    trail: color("trail"),
    faint: color("faint"),
    obstacle: color("obstacle"),
    robot: color("robot"),
    robotEdge: color("robot-edge"),
    person: color("person"),
    member: color("member"),
    none: color("none"),
  };
}
