! Optimize: -O2 -fvect-cost-model=dynamic
!> Branches of periodic motions: pseudo-arclength continuation (Keller 1977) of the map of a
!! period, with errors by another step size, bifurcation points and extremes.
module viscovib_motion_branch
  use, intrinsic :: ieee_arithmetic, only: ieee_is_nan, ieee_quiet_nan, ieee_value
  use viscovib_kinds, only: wp
  use viscovib_motion_events, only: event_grazing, find_events, motion_event
  use viscovib_motion_path, only: map_family, motion_path, motion_point
  use viscovib_outcomes, only: outcome_converged
  use viscovib_period_map, only: period_map
  use viscovib_shooting, only: accuracy_type, check_repeating, find_shortest_period, &
    check_periodic, steady_from_rest, steady_type
  use viscovib_status, only: fail, set_ok, show, status_input_error, status_type, things
  use viscovib_stopping, only: begin_piece, given_up
  implicit none
  private

  public :: branch_options, check_branch, motion_branch, trace_motion

  !> Outcome of a branch; no motion at the start of the range; no motion next to the start.
  integer, parameter, public :: branch_completed = 0, branch_stuck = 1, branch_points = 2, &
                                branch_stopped = 3, branch_without_start = 4, branch_singular = 5
  character(len=*), parameter, public :: branch_endings(0:5) = &
    [character(len=13) :: 'completed', 'stuck', 'points', 'stopped', 'without start', 'singular']
  !> Steps along the branch in units of z: the first, the shortest, and steps that may be at a
  !! corner.
  real(wp), parameter :: first_step = 0.005_wp, shortest = 1.0e-9_wp, corner = 1.0e-7_wp
  !> Cosines of the angle between two tangents below which steps are shorter and above which they
  !! are longer.
  real(wp), parameter :: bent = 0.97_wp, straight = 0.998_wp, growth = 1.6_wp
  !> Iterations after which steps may become longer.
  integer, parameter :: easy = 4

  type :: branch_options
    !> The range of the parameter, and the largest step, relative to the range and to the size of
    !! the first motion.
    real(wp) :: start = 0.0_wp, finish = 1.0_wp, max_step = 0.02_wp
    integer :: max_points = 2000
    type(accuracy_type) :: accuracy
    !> A state near the first motion, optionally without hidden states; not allocated: the motion
    !! from rest settles first.
    real(wp), allocatable :: begin(:)
  end type branch_options

  type :: motion_branch
    integer :: outcome = branch_completed
    !> Clause of a message about an end without a further step.
    character(len=:), allocatable :: reason
    !> Number of points with errors: fewer than were found after an interruption.
    integer :: n_points = 0
    !> For each point: the parameter, the motion with its errors, the allowed error, the number of
    !! load periods after which it repeats, and extremes, shape (n_dof, n).
    real(wp), allocatable :: p(:), allowed(:), low(:, :), high(:, :)
    type(steady_type), allocatable :: motions(:)
    integer, allocatable :: repeats_after(:)
    !> Events, each with the point before it, its location and error, NaN if it is not located, the
    !! largest displacements there, and true if stability is decided at both points next to it.
    integer, allocatable :: kind(:), before(:)
    real(wp), allocatable :: place(:), place_error(:), largest(:, :)
    logical, allocatable :: is_sure(:)
  end type motion_branch

contains

  !> Find a motion at the start of the range and follow it.
  subroutine trace_motion(family, options, branch)
    class(map_family), intent(inout), target :: family
    type(branch_options), intent(in) :: options
    type(motion_branch), intent(out) :: branch
    type(motion_path) :: path
    type(period_map) :: map
    type(steady_type) :: begun
    type(motion_point), allocatable :: points(:)
    real(wp), allocatable :: state(:)
    logical :: made

    branch%reason = ''
    call family%map_at(options%start, map, made)
    if (made) then
      if (allocated(options%begin)) then
        allocate (state(map%n_state()), source=0.0_wp)
        state(:size(options%begin)) = options%begin
        call check_repeating(map, state, options%accuracy, begun)
      else
        call steady_from_rest(map, options%accuracy, begun)
      end if
      made = begun%found%outcome == outcome_converged
    end if
    allocate (points(0))
    if (made) then
      path%family => family
      path%start = options%start
      path%finish = options%finish
      path%n_steps = begun%n_steps
      path%size = map%size_of(begun%found%state)
      if (.not. path%size > 0.0_wp) path%size = 1.0_wp
      path%tolerance = options%accuracy%allowed(map, begun%found%state)
      call path%set_units(map)
      call follow(path, begun%found%state, options, points, branch%outcome)
      if (size(points) == 0) branch%outcome = branch_singular
    else
      branch%outcome = branch_without_start
    end if
    if (given_up()) branch%outcome = branch_stopped
    if (branch%outcome == branch_stuck) branch%reason = path%switches_ahead(points(size(points)))
    call check_points(path, options%accuracy, points, branch)
    call check_events(path, points, branch)
  end subroutine trace_motion

  !> What is wrong with a branch, as further clauses of a sentence; empty if nothing is. Fails if
  !! the branch has no point.
  subroutine check_branch(branch, varies, start, doubts, status)
    type(motion_branch), intent(in) :: branch
    !> Name of the parameter, and the start of its range.
    character(len=*), intent(in) :: varies
    real(wp), intent(in) :: start
    character(len=:), allocatable, intent(out) :: doubts
    type(status_type), intent(out) :: status
    real(wp) :: errors(branch%n_points)
    logical :: above(branch%n_points)
    integer :: n

    call set_ok(status)
    doubts = ''
    if (branch%outcome == branch_without_start) then
      call fail(status, status_input_error, 'from', 'no motion that repeats was found at the ' &
                //'start, '//varies//' = '//show(start)//': give another initial or n_periods, ' &
                //'or start at another value')
    else if (branch%outcome == branch_singular) then
      call fail(status, status_input_error, 'from', 'the motion at the start, '//varies//' = ' &
                //show(start)//', cannot be followed, because it is not isolated (sticking ' &
                //'friction, or a fold): start at another value')
    else if (branch%outcome == branch_stuck) then
      doubts = '; the branch ends at '//varies//' = '//show(branch%p(branch%n_points)) &
               //': no step continues it'//branch%reason
    end if
    if (branch%n_points == 0) return
    n = count(ieee_is_nan(branch%place))
    if (n > 0) doubts = doubts//'; '//things(n, 'place')//' could not be located (nan)'
    errors = branch%motions(:branch%n_points)%error
    where (ieee_is_nan(errors)) errors = huge(start)
    above = errors > branch%allowed(:branch%n_points)
    if (.not. any(above)) return
    n = maxloc(errors, 1, above)
    doubts = doubts//'; the error exceeds the tolerance at '//things(count(above), 'point') &
             //', largest ('//show(errors(n))//') at '//varies//' = '//show(branch%p(n)) &
             //', because the step size is that of the start of the branch: give a smaller ' &
             //'tolerance, or start there'
  end subroutine check_branch

  !> Trace the points from the beginning of the range to its end.
  subroutine follow(path, state, options, points, outcome)
    type(motion_path), intent(in) :: path
    real(wp), intent(in) :: state(:)
    type(branch_options), intent(in) :: options
    type(motion_point), allocatable, intent(out) :: points(:)
    integer, intent(out) :: outcome
    type(motion_point) :: here, new
    real(wp) :: across(size(state) + 1), ahead, cosine, step
    integer :: at_corner, n
    logical :: found

    n = 0
    allocate (points(min(64, options%max_points)))
    outcome = branch_stuck
    ahead = sign(1.0_wp, path%finish - path%start)
    across = 0.0_wp
    across(size(across)) = 1.0_wp
    call path%correct([state, path%start]/path%units, across, new, found)
    if (found) then
      new%tangent = new%tangent*sign(ahead, ahead*new%tangent(size(across)))
      call add(new)
    end if
    at_corner = 0
    step = min(first_step, options%max_step)
    do while (found .and. n < options%max_points)
      call begin_piece()
      here = points(n)
      call path%correct(here%z + step*here%tangent, here%tangent, new, found)
      if (given_up()) exit
      if (found) call check_step(here, new, step, cosine, found)
      if (.not. found) then
        call shorten()
        found = step >= shortest
        cycle
      end if
      call look_at_ends()
      if (outcome /= branch_points) exit
      call add(new)
      ! For motions larger than the first one, steps are longer in proportion.
      if (cosine > straight .and. new%iterations <= easy) then
        step = min(growth*step, options%max_step &
                   *max(1.0_wp, maxval(abs(new%z(:size(state))))))
      end if
    end do
    call resize(points, n)

  contains

    subroutine add(point)
      type(motion_point), intent(in) :: point
      if (n == size(points)) call resize(points, 2*n)
      n = n + 1
      points(n) = point
      outcome = branch_points
    end subroutine add

    !> Halve the step; if steps are short, continue around a corner.
    subroutine shorten()
      type(motion_point) :: next
      logical :: made
      step = 0.5_wp*step
      outcome = merge(branch_points, branch_stuck, step >= shortest)
      if (step >= corner .or. at_corner == n) return
      at_corner = n
      call path%round_corner(here, next, made)
      if (.not. made) return
      call add(next)
      step = corner
    end subroutine shorten

    !> The last point at the end of the range, and the outcome there.
    subroutine look_at_ends()
      type(motion_point) :: last
      real(wp) :: end
      integer :: m
      m = size(across)
      end = path%finish/path%units(m)
      if (ahead*(new%z(m) - end) >= 0.0_wp) then
        call path%correct(here%z + (new%z - here%z)*((end - here%z(m))/(new%z(m) - here%z(m))), &
                          across, last, found)
        outcome = branch_stuck
        if (.not. found) return
        if (dot_product(last%tangent, here%tangent) < 0.0_wp) last%tangent = -last%tangent
        last%z(m) = end
        call add(last)
        outcome = branch_completed
      else if (ahead*(new%z(m) - path%start/path%units(m)) < 0.0_wp) then
        outcome = branch_completed
      end if
    end subroutine look_at_ends

  end subroutine follow

  !> Change the capacity of the array of points, which keeps as many points as fit.
  subroutine resize(points, capacity)
    type(motion_point), allocatable, intent(inout) :: points(:)
    integer, intent(in) :: capacity
    type(motion_point), allocatable :: kept(:)
    integer :: n
    n = min(size(points), capacity)
    allocate (kept(capacity))
    kept(:n) = points(:n)
    call move_alloc(kept, points)
  end subroutine resize

  !> Test if a step follows the branch: not to another part of it, and not around a bend.
  subroutine check_step(here, new, step, cosine, good)
    type(motion_point), intent(in) :: here, new
    real(wp), intent(in) :: step
    !> Cosine of the largest angle.
    real(wp), intent(out) :: cosine
    logical, intent(out) :: good

    cosine = cosine_of(here, new)
    good = .true.
    ! Another part of the branch, which runs the other way, is no branch point.
    if (abs(here%orientation() - new%orientation()) > 0.0_wp) then
      good = step <= first_step .and. new%n_passed == here%n_passed
    end if
    ! Near a kink the tangent turns for any step size.
    good = good .and. (cosine >= bent .or. step <= 1.0e3_wp*shortest)
  end subroutine check_step

  !> Cosine of the largest angle between the tangents of two points and the chord between them.
  pure real(wp) function cosine_of(one, other) result(cosine)
    type(motion_point), intent(in) :: one, other
    real(wp) :: chord(size(one%z))
    chord = other%z - one%z
    chord = chord/norm2(chord)
    cosine = min(dot_product(one%tangent, other%tangent), dot_product(one%tangent, chord), &
                 dot_product(other%tangent, chord))
  end function cosine_of

  !> Errors of each point by another number of steps, its shortest period and its extremes.
  subroutine check_points(path, accuracy, points, branch)
    type(motion_path), intent(in) :: path
    type(accuracy_type), intent(in) :: accuracy
    type(motion_point), intent(in) :: points(:)
    type(motion_branch), intent(inout) :: branch
    type(period_map) :: map
    real(wp), allocatable :: low(:), high(:)
    integer :: i, n
    logical :: made

    n = size(points)
    allocate (branch%p(n), branch%allowed(n), branch%motions(n), branch%repeats_after(n))
    allocate (branch%low(0, 0), branch%high(0, 0))
    do i = 1, n
      if (given_up()) exit
      call begin_piece()
      associate (z => points(i)%z)
        branch%p(i) = path%parameter_of(z)
        call path%family%map_at(branch%p(i), map, made)
        call check_periodic(map, path%state_of(z), path%n_steps, points(i)%correction*path%size, &
                             branch%motions(i))
        branch%repeats_after(i) = find_shortest_period(map, branch%motions(i))
        branch%allowed(i) = accuracy%allowed(map, path%state_of(z))
      end associate
      call path%extremes(points(i)%z, low, high)
      if (i == 1) then
        deallocate (branch%low, branch%high)
        allocate (branch%low(size(low), n), branch%high(size(low), n))
      end if
      branch%low(:, i) = low
      branch%high(:, i) = high
      if (.not. given_up()) branch%n_points = i
    end do
  end subroutine check_points

  !> Events between the points.
  subroutine check_events(path, points, branch)
    type(motion_path), intent(in) :: path
    type(motion_point), intent(in) :: points(:)
    type(motion_branch), intent(inout) :: branch
    type(motion_event), allocatable :: found(:)
    real(wp), allocatable :: low(:), high(:)
    real(wp) :: blur(branch%n_points)
    integer :: i, k, n

    n = branch%n_points
    blur = [(branch%motions(i)%multiplier_error, i=1, n)]
    call find_events(path, points(:n), blur, found)
    branch%kind = found%kind
    branch%before = found%before
    allocate (branch%is_sure(size(found)))
    allocate (branch%place(size(found)), source=ieee_value(0.0_wp, ieee_quiet_nan))
    branch%place_error = branch%place
    allocate (branch%largest(size(branch%low, 1), size(found)), &
              source=ieee_value(0.0_wp, ieee_quiet_nan))
    do k = 1, size(found)
      i = found(k)%before
      branch%is_sure(k) = min(branch%motions(i)%stability(), branch%motions(i + 1)%stability()) &
                          >= 0 .or. found(k)%kind == event_grazing
      if (.not. allocated(found(k)%z)) cycle
      branch%place(k) = path%parameter_of(found(k)%z)
      branch%place_error(k) = found(k)%error*path%units(size(path%units))
      call path%extremes(found(k)%z, low, high)
      branch%largest(:, k) = high
    end do
  end subroutine check_events

end module viscovib_motion_branch
