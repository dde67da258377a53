// The physics of a team that a person leads, a period at a time.
import { Computed } from "./computed.js";

export class Lead extends Computed {
  // Lead for a period under a command; return its row.
  step(command) {
    if (this.period("lead", command) !== -1) throw new Error("the team diverged");
    this.k += 1;
    const { columns, size, robot } = this.plan,
      trust = this.config.start.map((_, i) => this.number("followers", i * size + robot.trust)),
      logged = Array.from({ length: columns }, (_, i) => this.number("row", 8 * i));
    this.row = [...command, ...logged, ...trust];
    return this.row;
  }

  // What the page draws.
  picture() {
    const { columns, goals, samples, sample_time } = this.config,
      logged = Object.fromEntries(columns.map((name, i) => [name, this.row[i]])),
      reached = logged.goals_reached,
      { size, robot, wait } = this.plan;
    return {
      k: this.k,
      t: this.k * sample_time,
      done: reached === goals.length || this.k >= samples,
      robots: this.config.start.map((_, i) => this.pair("followers", i * size + robot.place)),
      trust: columns.filter((name) => name.startsWith("trust_")).map((name) => logged[name]),
      leader: logged.leader,
      suggested: logged.leader_suggested,
      wait: this.number("leads", wait),
      goal: goals[Math.min(reached, goals.length - 1)],
      reached,
      force: [-logged.f_m_x, -logged.f_m_y],
    };
  }
}
