// Five exercises for a class: the conduction state to begin with, what to do, and what is to be seen.

export const EXERCISES = [
  {
    name: "1. Bundle branch blocks",
    conduction: 0,
    text: "Pin the normal beat. Choose the conduction state “left bundle branch block”, then the "
      + "right one. Which wall is activated last in each? Look for the broad R in V6 and the late R "
      + "in V1. How much longer does the QRS become? Then block only a part: with “block a branch” "
      + "click the left bundle half-way down. Does the ECG differ from that of the complete block?",
  },
  {
    name: "2. A fascicular block",
    conduction: 3,
    text: "This is a left anterior fascicular block. Pin it, choose “normal”, and watch the frontal axis. "
      + "Why does the axis turn although the QRS becomes hardly longer? Then the posterior one: "
      + "which way does the axis turn? Shorten the anterior fascicle instead: can its length alone "
      + "imitate a block?",
  },
  {
    name: "3. Block or slow tissue?",
    conduction: 8,
    text: "In intraventricular delay the network conducts and the tissue is slow. Lower α until the "
      + "QRS is as long as in left bundle branch block, and pin it. Compare the leads with those of "
      + "the block. Then pace the left bundle in both: in which does pacing shorten the activation?",
  },
  {
    name: "4. Where does an ectopic beat come from?",
    conduction: 0,
    text: "With “pace here” click the right ventricular outflow tract, near the base in front: the "
      + "QRS is positive in II, III and aVF. Undo, and click the apex below: it is negative. Undo, and "
      + "click the lateral wall of the left ventricle: look at V1. Find a site with a QRS that is "
      + "positive in all chest leads. When do fronts enter the Purkinje network?",
  },
  {
    name: "5. Pacing a left bundle branch block",
    conduction: 1,
    text: "Pin the block. Choose right ventricular apical pacing, then biventricular, then left "
      + "bundle branch and His bundle pacing. Which has the shortest total activation time, and "
      + "which the shortest QRS? Step through the networks of a study: does the order stay the same?",
  },
];
