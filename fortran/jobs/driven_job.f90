!> A branch of driven motions of the pendulum along a frequency or an amplitude of its loads, and
!! branches that bifurcate from it.
module viscovib_driven_job
  use viscovib_crossing_errors, only: branch_point_error, exponent_error
  use viscovib_crossings, only: crossing_type
  use viscovib_curve_branch, only: curve_branch_type, curve_completed, curve_options, &
    curve_outcomes, follow_curve
  use viscovib_column_notes, only: driven_error_note, driven_note, stability_note
  use viscovib_curve_columns, only: add_stability, note_crossings, note_folds
  use viscovib_drive_torus, only: checking_shells, drive_torus_type, kept_by_symmetry, &
    largest_bound, lattice, max_unknowns, n_drives, varied_names, varies_nu
  use viscovib_job, only: job_report, job_type, plan_line, plan_unwanted, table_sink
  use viscovib_kinds, only: wp
  use viscovib_number_text, only: exact
  use viscovib_orbit_floquet, only: orbit_floquet_type
  use viscovib_orbit_multipliers, only: count_larger
  use viscovib_orbit_stability, only: check_orbits, find_orbit_crossings, orbit_circle, &
    orbit_spectrum
  use viscovib_order_rules, only: better_bound, max_vain
  use viscovib_outcomes, only: outcome_converged
  use viscovib_pendulum, only: new_pendulum, pendulum_parameters, pendulum_type
  use viscovib_status, only: fail, set_ok, show, status_input_error, status_type, things
  use viscovib_stopping, only: given_up
  use viscovib_subject, only: subject_type
  use viscovib_table, only: listed, table_type
  use viscovib_torus, only: new_torus, torus_type
  use viscovib_torus_balance, only: new_torus_balance, torus_balance_type, vary_amplitude, &
    vary_frequency
  use viscovib_torus_orders, only: branch_truncation, fold_truncation, new_ladder, torus_ladder
  use viscovib_torus_response, only: solve_from_rest
  implicit none
  private

  !> Largest number of unknowns with added harmonics, relative to the allowed number.
  real(wp), parameter :: fewer = 2.0_wp

  public :: driven_job, follow_with_enough, leaving_type, tracing_type

  type, extends(job_type) :: driven_job
    !> Index in `varied_names`.
    integer :: parameter = 1
    type(curve_options) :: options
    !> Highest order; the first one if orders are chosen.
    integer :: harmonics = 0
    logical :: choose_harmonics = .true.
    logical :: stability = .true.
    !> Only motions with the symmetry of system and loads.
    logical :: symmetric = .false.
    integer :: subharmonic = 1, max_denominator = 12
    !> Branch points at which to switch, counted from 1; negative: in the other direction.
    integer, allocatable :: switch(:)
    type(drive_torus_type) :: torus
  contains
    procedure :: plan => plan_driven
    procedure :: run
    procedure :: kept_of
  end type driven_job

  !> A branch, its values in units of the parameter.
  type :: driven_branch
    integer :: outcome = curve_completed
    !> Highest order kept, and the largest estimated relative error of omitting higher
    !! orders.
    integer :: harmonics = 0
    real(wp) :: truncation = 0.0_wp
    !> Shape (n); base frequencies, shape (n_axes, n); unknowns, with omitted ones as 0, shape
    !! (torus%n n_dof, n).
    real(wp), allocatable :: parameter(:), base(:, :), x(:, :)
    !> Remaining error of the last correction and of rounding, at the value of the parameter and off
    !! the curve, shape (n).
    real(wp), allocatable :: error(:), off(:)
    real(wp), allocatable :: folds(:), fold_errors(:), branch_points(:), branch_errors(:)
    !> Largest first, NaN if unknown, shape (6, n), and changes of stability; not allocated
    !! if not requested, or with several base frequencies.
    complex(wp), allocatable :: multipliers(:, :)
    type(crossing_type), allocatable :: crossings(:)
  end type driven_branch

  !> A point at which a branch leaves another one: all unknowns, the parameter, and the direction in
  !! both, with orders up to the bound of the job.
  type :: leaving_type
    real(wp), allocatable :: begin(:), along(:)
    real(wp) :: parameter = 0.0_wp
  end type leaving_type

  !> Branches of one pendulum, with orders up to a bound.
  type :: tracing_type
    !> System with loads of size 1 and separate amplitudes, since one of them may be varied.
    type(pendulum_type) :: system
    real(wp) :: load(n_drives) = 0.0_wp
    type(torus_type) :: torus
    type(torus_balance_type) :: balance
    !> In units of the varied quantity of the balance; `unit` is its ratio to the parameter.
    type(curve_options) :: options
    real(wp) :: unit = 1.0_wp
    integer :: bound = 0
    !> The varied quantity of the balance, as of `torus_balance_type`.
    integer :: vary = vary_frequency, which = 1
  contains
    procedure :: in_full
    procedure :: find_stability
    procedure :: begin
    procedure :: set_balance
    procedure, private :: follow_first
    procedure, private :: solve_first
    procedure, private :: check_truncation
    procedure, private :: check_branch_points
    procedure, private :: new_checking_ladder
    procedure, private :: check_crossings
    procedure, private :: keep
  end type tracing_type

contains

  subroutine plan_driven(self, subject, text, status)
    class(driven_job), intent(in) :: self
    type(subject_type), intent(in), target :: subject
    character(len=:), allocatable, intent(out) :: text
    type(status_type), intent(out) :: status

    call set_ok(status)
    text = 'computes: the branch from '//trim(varied_names(self%parameter))//' = ' &
           //show(self%options%start)//' to '//show(self%options%finish)//', '
    if (self%torus%n_axes == 1) then
      text = text//'periodic motions'
    else
      text = text//'quasi-periodic motions of '//show(self%torus%n_axes)//' base frequencies'
    end if
    if (self%choose_harmonics) then
      text = text//', harmonics chosen to meet the tolerance, '//show(self%harmonics)//' at first'
    else
      text = text//', '//things(size(lattice(self%torus%n_axes, self%harmonics), 2), 'harmonic') &
             //' per coordinate'
    end if
    text = text//new_line('a') &
           //plan_line(size(self%switch) > 0, things(size(self%switch), 'branch that bifurcates', &
                                                     'bifurcating branches'), &
                       'branches that bifurcate from it (no switch)')
    if (self%stability) then
      text = text//plan_line(self%torus%n_axes == 1, &
                             'stability of each motion, and where it changes', &
                             'stability (of quasi-periodic motions: only in Python, over a ' &
                             //'duration)')
    else
      text = text//'skips: stability (not requested)'//new_line('a')
    end if
    if (self%symmetric) text = text//'skips: orders that the symmetry of system and loads rules ' &
                              //'out'//new_line('a')
    text = text//plan_unwanted('columns', subject, self%wanted)
  end subroutine plan_driven

  !> A table for the branch and one for each bifurcating branch, in the given order.
  subroutine run(self, subject, sink, report, status)
    class(driven_job), intent(in) :: self
    type(subject_type), intent(in), target :: subject
    class(table_sink), intent(inout) :: sink
    type(job_report), intent(out) :: report
    type(status_type), intent(out) :: status
    type(driven_branch), allocatable :: branches(:)
    type(table_type) :: table
    character(len=:), allocatable :: name
    integer :: blurred, i, short

    call trace(self, subject%pendulum, branches, status)
    if (status%failed()) return
    do i = 1, size(branches)
      name = self%kind
      if (i > 1) name = name//'_'//show(i - 1)
      call tabulate(self, subject, branches(i), table)
      call sink%put(name, table, status)
      if (status%failed()) return
    end do
    short = count(branches%truncation > self%options%tolerance)
    associate (first => branches(1))
      report%complete = first%outcome == curve_completed .and. short == 0
      report%summary = trim(curve_outcomes(first%outcome))//', ' &
                       //things(size(first%parameter), 'point')//', ' &
                       //things(size(first%folds), 'fold')//', ' &
                       //things(size(first%branch_points), 'branch point')
    end associate
    if (short > 0) report%summary = report%summary//', '//show(short)//' of ' &
                                    //things(size(branches), 'branch', 'branches') &
                                    //' with too few harmonics'
    blurred = sum([(count(branches(i)%off > self%options%tolerance), i=1, size(branches))])
    if (blurred > 0) report%summary = report%summary//', '//things(blurred, 'point') &
                                      //' with a rounding error above the tolerance'
    if (size(branches) > 1) report%summary = report%summary//'; ' &
                                             //things(size(branches) - 1, 'bifurcating branch', &
                                                      'bifurcating branches')
  end subroutine run

  !> The branch, with as many orders as it needs, then the bifurcating branches.
  subroutine trace(job, pendulum, branches, status)
    type(driven_job), intent(in) :: job
    type(pendulum_type), intent(in) :: pendulum
    type(driven_branch), allocatable, target, intent(out) :: branches(:)
    type(status_type), intent(out) :: status
    type(tracing_type), target :: tracing
    type(curve_branch_type) :: first, other
    real(wp) :: truncation
    integer :: i, n

    allocate (branches(1 + size(job%switch)))
    call follow_with_enough(job, pendulum, tracing, first, truncation, status)
    if (status%failed()) return
    call tracing%keep(job, first, branches(1), status)
    if (status%failed()) return
    branches(1)%truncation = truncation
    do i = 1, size(job%switch)
      n = abs(job%switch(i))
      if (n > first%branch_points%n) then
        call fail(status, status_input_error, 'switch', 'switch = '//show(job%switch(i)) &
                  //': the branch has '//things(first%branch_points%n, 'branch point'))
        return
      end if
      associate (points => first%branch_points)
        call follow_curve(tracing%balance, tracing%options, points%x(:, n), other, &
                          points%p(n)*tracing%unit/tracing%unit, &
                          sign(1, job%switch(i))*points%across(:, n))
      end associate
      call tracing%check_truncation(job, other, truncation, status)
      if (.not. status%failed()) call tracing%check_branch_points(job, other, status)
      if (.not. status%failed()) call tracing%keep(job, other, branches(i + 1), status)
      if (status%failed()) return
      branches(i + 1)%truncation = truncation
    end do
  end subroutine trace

  !> The branch from its beginning, or where it leaves another one, with more orders until they
  !! suffice or bring no gain; with errors of its folds and branch points.
  subroutine follow_with_enough(job, pendulum, tracing, branch, truncation, status, leave, cancel)
    type(driven_job), intent(in) :: job
    type(pendulum_type), intent(in) :: pendulum
    type(tracing_type), target, intent(inout) :: tracing
    type(curve_branch_type), intent(inout) :: branch
    real(wp), intent(out) :: truncation
    type(status_type), intent(out) :: status
    type(leaving_type), intent(in), optional :: leave
    !> May be set by another thread to cancel the computation.
    integer, intent(inout), optional :: cancel
    real(wp) :: last
    integer :: next, vain, most

    truncation = huge(1.0_wp)
    call tracing%begin(job, pendulum, status)
    if (status%failed()) return
    most = tracing%bound
    if (job%choose_harmonics) then
      most = max(most, largest_bound(job%torus%n_axes, fewer, max_unknowns))
    end if
    vain = 0
    do
      last = truncation
      call tracing%follow_first(job, branch, status, leave, cancel)
      if (.not. status%failed()) call tracing%check_truncation(job, branch, truncation, status, &
                                                               cancel)
      if (status%failed()) return
      if (truncation <= tracing%options%tolerance .or. tracing%bound >= most) exit
      if (truncation > 0.5_wp*last) vain = vain + 1
      if (vain >= max_vain) exit
      next = better_bound(tracing%bound, truncation, tracing%options%tolerance, &
                          checking_shells(job%torus), most)
      if (next <= tracing%bound) exit
      tracing%bound = next
    end do
    call tracing%check_branch_points(job, branch, status, cancel)
  end subroutine follow_with_enough

  subroutine begin(self, job, pendulum, status)
    class(tracing_type), intent(inout) :: self
    type(driven_job), intent(in) :: job
    type(pendulum_type), intent(in) :: pendulum
    type(status_type), intent(out) :: status
    type(pendulum_parameters) :: parameters

    parameters = pendulum%parameters
    self%load = parameters%load
    parameters%load = 1.0_wp
    self%bound = job%harmonics
    if (job%parameter > n_drives .and. job%parameter < varies_nu) then
      self%vary = vary_amplitude
      self%which = job%parameter - n_drives
    else
      self%vary = vary_frequency
      self%which = job%torus%axis
      self%unit = real(job%torus%multiple, wp)
    end if
    call new_pendulum(self%system, parameters, status)
  end subroutine begin

  !> The balance with orders up to the bound.
  subroutine set_balance(self, job, status)
    class(tracing_type), intent(inout), target :: self
    type(driven_job), intent(in) :: job
    type(status_type), intent(out) :: status

    call new_torus(self%torus, lattice(job%torus%n_axes, self%bound), status)
    if (status%failed()) return
    call new_torus_balance(self%balance, self%system, self%torus, job%torus%orders, &
                           job%torus%base, self%load, job%kept_of(self%torus%orders, self%load))
    self%balance%vary = self%vary
    self%balance%which = self%which
    if (self%vary == vary_frequency) self%balance%lowest = 0.0_wp
  end subroutine set_balance

  !> The branch from its beginning, or where it leaves another one.
  subroutine follow_first(self, job, branch, status, leave, cancel)
    class(tracing_type), intent(inout), target :: self
    type(driven_job), intent(in) :: job
    type(curve_branch_type), intent(inout) :: branch
    type(status_type), intent(out) :: status
    type(leaving_type), intent(in), optional :: leave
    integer, intent(inout), optional :: cancel
    real(wp), allocatable :: x(:), along(:)
    integer :: m

    call self%set_balance(job, status)
    if (status%failed()) return
    self%options = job%options
    self%options%start = job%options%start/self%unit
    self%options%finish = job%options%finish/self%unit
    if (allocated(job%options%stops)) self%options%stops = job%options%stops/self%unit
    branch%n_points = 0
    if (.not. present(leave)) then
      call self%solve_first(job, branch, status, cancel)
      return
    end if
    m = 3*self%torus%n
    x = self%balance%reduced(leave%begin)
    along = self%balance%reduced(leave%along(:m))
    if (norm2(along) < (1.0_wp - 1.0e-6_wp)*norm2(leave%along(:m))) then
      call fail(status, status_input_error, 'leave', 'leave: the bifurcating motions do not have ' &
                //'this symmetry: give symmetric=False')
      return
    end if
    call follow_curve(self%balance, self%options, x, branch, leave%parameter/self%unit, &
                      [along, leave%along(m + 1)], cancel)
  end subroutine follow_first

  !> The branch from the motion at its beginning.
  subroutine solve_first(self, job, branch, status, cancel)
    class(tracing_type), intent(inout), target :: self
    type(driven_job), intent(in) :: job
    type(curve_branch_type), intent(inout) :: branch
    type(status_type), intent(out) :: status
    integer, intent(inout), optional :: cancel
    real(wp) :: x(self%balance%n)
    integer :: outcome, iterations

    call set_ok(status)
    iterations = 0
    call solve_from_rest(self%balance, self%options%start, self%options%tolerance, x, outcome, &
                         iterations, cancel)
    if (outcome == outcome_converged) then
      call follow_curve(self%balance, self%options, x, branch, cancel=cancel)
    end if
    if (branch%n_points > 0) return
    call fail(status, status_input_error, 'from', trim(varied_names(job%parameter)) &
              //': no solution was found at the start '//show(job%options%start) &
              //': start at another value')
  end subroutine solve_first

  !> Orders and coordinates that are unknowns.
  function kept_of(self, orders, load) result(kept)
    class(driven_job), intent(in) :: self
    integer, intent(in) :: orders(:, :)
    real(wp), intent(in) :: load(n_drives)
    logical :: kept(size(orders, 2), 3)
    kept = .true.
    if (self%symmetric) kept = kept_by_symmetry(self%torus, orders, load, self%parameter)
  end function kept_of

  !> Largest change by more harmonics; errors of folds.
  subroutine check_truncation(self, job, branch, truncation, status, cancel)
    class(tracing_type), intent(in) :: self
    type(driven_job), intent(in) :: job
    type(curve_branch_type), intent(inout) :: branch
    real(wp), intent(out) :: truncation
    type(status_type), intent(out) :: status
    integer, intent(inout), optional :: cancel
    type(torus_ladder) :: ladder
    real(wp) :: moved(branch%folds%n)

    truncation = 0.0_wp
    call self%new_checking_ladder(job, checking_shells(job%torus), ladder)
    associate (n => branch%n_points, folds => branch%folds)
      call branch_truncation(ladder, branch%parameter(:n), self%in_full(branch%x(:, :n)), &
                             self%options%tolerance, truncation, status, cancel)
      if (status%failed()) return
      call fold_truncation(ladder, branch%parameter(:n), self%in_full(branch%x(:, :n)), &
                           folds%p(:folds%n), self%in_full(folds%x(:, :folds%n)), &
                           folds%before(:folds%n), moved, status, cancel)
      folds%error(:folds%n) = folds%error(:folds%n) + moved
    end associate
  end subroutine check_truncation

  !> Errors of branch points.
  subroutine check_branch_points(self, job, branch, status, cancel)
    class(tracing_type), intent(in) :: self
    type(driven_job), intent(in) :: job
    type(curve_branch_type), intent(inout) :: branch
    type(status_type), intent(out) :: status
    integer, intent(inout), optional :: cancel

    call set_ok(status)
    associate (n => branch%branch_points%n, points => branch%branch_points)
      points%error(:n) = 0.0_wp
      if (n == 0 .or. branch%n_points < 2) return
      call find_errors(self, job, branch, points%p(:n), self%in_full(points%x(:, :n)), &
                       points%before(:n), points%error(:n), status, cancel)
    end associate
  end subroutine check_branch_points

  !> Orders up to the bound, and additional shells for the error estimate.
  subroutine new_checking_ladder(self, job, shells, ladder)
    class(tracing_type), intent(in) :: self
    type(driven_job), intent(in) :: job
    integer, intent(in) :: shells
    type(torus_ladder), intent(out) :: ladder
    integer, allocatable :: orders(:, :)

    orders = lattice(job%torus%n_axes, self%bound + shells)
    call new_ladder(ladder, self%system, orders, job%kept_of(orders, self%load), &
                    job%torus%orders, job%torus%base, self%load, self%balance%vary, &
                    self%balance%which, self%bound, self%bound, shells)
  end subroutine new_checking_ladder

  !> Number of additional shells for the errors of bifurcation points.
  pure integer function shells_of_places(bound, torus) result(shells)
    integer, intent(in) :: bound
    type(drive_torus_type), intent(in) :: torus
    shells = checking_twice(torus%n_axes, checking_shells(torus), bound, &
                           largest_bound(torus%n_axes, 1.0_wp, max_unknowns))
  end function shells_of_places

  !> Errors of the locations of changes of stability.
  subroutine check_crossings(self, job, branch, crossings, status, cancel)
    class(tracing_type), intent(in) :: self
    type(driven_job), intent(in) :: job
    type(curve_branch_type), intent(in) :: branch
    type(crossing_type), intent(inout) :: crossings(:)
    type(status_type), intent(out) :: status
    integer, intent(inout), optional :: cancel
    real(wp) :: x(self%torus%n*3, size(crossings)), errors(size(crossings))
    integer :: i

    x = 0.0_wp
    errors = 0.0_wp
    do i = 1, size(crossings)
      if (.not. crossings(i)%located) cycle
      x(:, i:i) = self%in_full(reshape(crossings(i)%x, [size(crossings(i)%x), 1]))
      errors(i) = crossings(i)%error
    end do
    call set_ok(status)
    if (any(errors < 0.0_wp)) call find_errors(self, job, branch, [crossings%p], x, &
                                               [crossings%before], errors, status, cancel, &
                                               aimag(crossings%eta))
    crossings%error = errors
  end subroutine check_crossings

  !> Unknowns with omitted ones as 0, a column each.
  pure function in_full(self, x) result(whole)
    class(tracing_type), intent(in) :: self
    real(wp), intent(in) :: x(:, :)
    real(wp) :: whole(self%torus%n*3, size(x, 2))
    integer :: k
    do k = 1, size(x, 2)
      whole(:, k) = reshape(self%balance%expanded(x(:self%balance%n, k)), [self%torus%n*3])
    end do
  end function in_full

  !> Multipliers of each point, largest first, NaN if unknown, and changes of stability, for one
  !! base frequency.
  subroutine find_stability(self, job, branch, multipliers, crossings, status, cancel)
    class(tracing_type), intent(inout), target :: self
    type(driven_job), intent(in) :: job
    type(curve_branch_type), intent(in) :: branch
    !> Shape (6, n).
    complex(wp), intent(out) :: multipliers(:, :)
    type(crossing_type), allocatable, intent(out) :: crossings(:)
    type(status_type), intent(out) :: status
    integer, intent(inout), optional :: cancel
    ! Its steps are those of the branch, independent of earlier computations.
    type(orbit_floquet_type) :: floquet

    associate (p => branch%parameter(:branch%n_points), x => branch%x(:, :branch%n_points))
      call check_orbits(floquet, self%balance, p, x, multipliers, cancel)
      call find_orbit_crossings(floquet, self%balance, p, x, multipliers, branch%folds, &
                                branch%branch_points, crossings, cancel)
    end associate
    call self%check_crossings(job, branch, crossings, status, cancel)
  end subroutine find_stability

  !> A branch in units of the parameter, with its stability.
  subroutine keep(self, job, from, to, status)
    class(tracing_type), intent(inout), target :: self
    type(driven_job), intent(in) :: job
    type(curve_branch_type), intent(in) :: from
    type(driven_branch), intent(out) :: to
    type(status_type), intent(out) :: status
    integer :: n

    call set_ok(status)
    n = from%n_points
    to%outcome = from%outcome
    to%harmonics = self%bound
    to%parameter = from%parameter(:n)*self%unit
    to%base = spread(job%torus%base, 2, n)
    if (self%balance%vary == vary_frequency) to%base(self%balance%which, :) = from%parameter(:n)
    to%x = self%in_full(from%x(:, :n))
    to%error = from%error(:n)
    to%off = from%off(:n)
    to%folds = from%folds%p*self%unit
    to%fold_errors = from%folds%error*self%unit
    to%branch_points = from%branch_points%p*self%unit
    to%branch_errors = from%branch_points%error*self%unit
    if (.not. job%stability .or. job%torus%n_axes > 1) return
    allocate (to%multipliers(6, n))
    call self%find_stability(job, from, to%multipliers, to%crossings, status)
    to%crossings%p = to%crossings%p*self%unit
    to%crossings%error = to%crossings%error*self%unit
  end subroutine keep

  !> One row per point.
  subroutine tabulate(self, subject, branch, table)
    type(driven_job), intent(in) :: self
    type(subject_type), intent(in) :: subject
    type(driven_branch), intent(in), target :: branch
    type(table_type), intent(out) :: table
    integer, allocatable :: orders(:, :)
    character(len=:), allocatable :: varies, title, note
    integer :: i, j, d, k, m, n

    allocate (orders, source=lattice(self%torus%n_axes, branch%harmonics))
    varies = trim(varied_names(self%parameter))
    n = size(branch%parameter)
    call note_folds(table, 'branch', curve_outcomes(branch%outcome), varies, branch%folds, &
                    branch%fold_errors)
    call table%note('branch points at '//varies//' ='//listed(branch%branch_points))
    if (size(branch%branch_points) > 0) then
      call table%note('estimated errors of these branch points:'//listed(branch%branch_errors))
    end if
    call table%add_reals(varies, branch%parameter)
    do i = 1, self%torus%n_axes
      call table%add_reals('omega_'//show(i), branch%base(i, :))
    end do
    note = driven_note
    if (allocated(branch%multipliers)) then
      call note_crossings(table, branch%crossings, varies)
      note = note//stability_note
      call add_stability(table, [(count_larger(branch%multipliers(:, i), orbit_circle), i=1, n)], &
                         branch%multipliers(1, :))
    end if
    call table%note(note//'; harmonics up to '//show(branch%harmonics)//', largest ' &
                    //'estimated relative error '//trim(exact(branch%truncation)) &
                    //driven_error_note)
    call table%add_reals('error', branch%error)
    do j = 1, size(self%wanted)
      d = self%wanted(j)
      i = (d - 1)*(2*size(orders, 2) - 1)
      do k = 1, size(orders, 2)
        title = trim(subject%coordinates(d))//'_'//show(orders(1, k))
        do m = 2, size(orders, 1)
          title = title//','//show(orders(m, k))
        end do
        ! The mean is Im X_0.
        if (k == 1) then
          call table%hold_reals(title//'_re', [(0.0_wp, m=1, n)])
        else
          i = i + 1
          call table%add_reals(title//'_re', branch%x(i, :))
        end if
        i = i + 1
        call table%add_reals(title//'_im', branch%x(i, :))
      end do
    end do
  end subroutine tabulate

  ! Errors of special points along a branch of motions of a driven system: branch points, and
  ! changes of stability. Both are located again with more shells of orders.

  !> Number of additional shells for the errors of locations: for one axis as many as the bound,
  !! since the next omitted orders may cancel each other.
  pure integer function checking_twice(n_axes, shells, bound, most) result(step)
    !> Number of shells that check motions, the bound, and its largest value.
    integer, intent(in) :: n_axes, shells, bound, most
    step = shells
    if (n_axes == 1) step = max(shells, min(bound, most - bound)/shells*shells)
  end function checking_twice

  !> Errors of branch points, or of locations where multipliers cross the unit circle, for one axis.
  subroutine find_errors(self, job, branch, at_p, at_x, before, error, status, cancel, turn)
    class(tracing_type), intent(in) :: self
    type(driven_job), intent(in) :: job
    type(curve_branch_type), intent(in) :: branch
    !> Locations, with all unknowns: shapes (n), (torus%n n_dof, n).
    real(wp), intent(in) :: at_p(:), at_x(:, :)
    !> Index of the point before each location, from 1.
    integer, intent(in) :: before(:)
    !> Errors in the unit of p, shape (size(at_p)); of crossings computed where it is < 0.
    real(wp), intent(inout) :: error(:)
    type(status_type), intent(out) :: status
    integer, intent(inout), optional :: cancel
    !> Argument of the multiplier that crosses; absent: branch points.
    real(wp), intent(in), optional :: turn(:)
    type(torus_ladder) :: ladder
    type(orbit_floquet_type), target :: floquet
    type(orbit_spectrum) :: spectrum
    real(wp), allocatable :: ends(:, :)
    integer :: first, i

    call self%new_checking_ladder(job, shells_of_places(self%bound, job%torus), ladder)
    call ladder%prepare(ladder%last, status)
    if (.not. status%failed()) call ladder%prepare(ladder%last + ladder%step, status)
    if (status%failed()) return
    associate (balance => ladder%rungs(ladder%last + ladder%step)%balance)
      spectrum%floquet => floquet
      spectrum%n = 2*balance%system%n_dof
      do i = 1, size(at_p)
        if (given_up(cancel)) return
        if (present(turn) .and. .not. error(i) < 0.0_wp) cycle
        call neighbours(ladder, self%in_full(branch%x(:, :branch%n_points)), before(i), first, ends)
        associate (p => branch%parameter(first:first + 1), x => ladder%lifted(at_x(:, i)))
          if (present(turn)) then
            call exponent_error(balance, spectrum, p, ends, at_p(i), x, &
                                cmplx(0.0_wp, turn(i), wp), error(i), cancel)
          else
            call branch_point_error(balance, p, ends, at_p(i), x, error(i), cancel)
          end if
        end associate
      end do
    end associate
  end subroutine find_errors

  !> The points of the branch near a location, in the unknowns of more shells.
  subroutine neighbours(ladder, x, before, first, ends)
    type(torus_ladder), intent(in) :: ladder
    real(wp), intent(in) :: x(:, :)
    integer, intent(in) :: before
    integer, intent(out) :: first
    !> Shape (balance%n, 2).
    real(wp), allocatable, intent(out) :: ends(:, :)

    first = max(1, min(before, size(x, 2) - 1))
    associate (one => ladder%lifted(x(:, first)), other => ladder%lifted(x(:, first + 1)))
      allocate (ends(size(one), 2))
      ends(:, 1) = one
      ends(:, 2) = other
    end associate
  end subroutine neighbours

end module viscovib_driven_job
