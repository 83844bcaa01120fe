!> Requested events of a run: zero crossings of functions of the state.
module viscovib_watch
  use viscovib_all_event_points, only: event_point_search
  use viscovib_extremes, only: extremes_type
  use viscovib_kinds, only: wp
  use viscovib_law_branches, only: signal_type
  use viscovib_law_functions, only: put_argument, wall
  use viscovib_step_path, only: step_path
  implicit none
  private

  public :: watch_type, new_watch, event_point_type, coordinates_read, renumbered

  !> Part of its largest value so far below which a signal counts as 0 while the motion sticks.
  real(wp), parameter :: at_rest = 1.0e-11_wp
  !> Lower bound of a signal's largest value once it has had a value, even if 0.
  real(wp), parameter :: valued = 2.0_wp**(-1000)

  !> One crossing: the index of its signal, the sign before it, its position in the step, and the
  !! change of the signal there, as in `event_point_search`.
  type :: event_point_type
    integer :: which = 0, side = 1
    real(wp) :: place = 0.0_wp, rate = 0.0_wp, bend = 0.0_wp
  end type event_point_type

  !> Rows of a crossing in addition to the state: signal, time, rate and bend.
  integer, parameter, public :: n_event_rows = 4

  type :: watch_type
    type(signal_type), allocatable :: signals(:)
    !> Coordinates in the states that the signals receive; not allocated: all of them.
    integer, allocatable :: reads(:)
    !> Sample points in parts of steps, and the matrix from samples of a signal to its last
    !! coefficients (`viscovib_march_events`), once they are built.
    type(step_path), allocatable :: path
    real(wp), allocatable :: last(:, :)
    !> Largest values of the arguments of signals.
    real(wp), allocatable :: scales(:)
    !> Directions that count: upwards 1, downwards -1, both 0; true if the event ends the run.
    integer, allocatable :: direction(:)
    logical, allocatable :: terminal(:)
    !> Last known side of 0 of each signal, 0: none yet; its largest value so far, 0 if it
    !! had no value.
    integer, allocatable :: sides(:)
    real(wp), allocatable :: largest(:)
    !> Signals may change anywhere between points, so the search uses interval bounds. For each
    !! signal: number of steps in which crossings may be missing.
    integer, allocatable :: lost(:)
    type(event_point_search) :: search
    !> Peaks and means along the motion, if they are requested.
    type(extremes_type) :: extremes
    !> Crossings found: signal and time; states, including hidden coordinates, and
    !! accelerations; rate and bend of the signal. Shapes (n), (2 n_dof, n), (n_dof, n), (2, n).
    integer :: n_found = 0
    integer, allocatable :: which(:)
    real(wp), allocatable :: times(:), states(:, :), accelerations(:, :), changes(:, :)
  contains
    procedure :: look
    procedure :: count_of
    procedure :: keep
    procedure :: drop_after
    procedure :: rows
    procedure :: hand_over
  end type watch_type

contains

  !> Decode a vector: the number of signals; for each direction, 1 if terminal, number of
  !! instructions, and code and number of each, with arguments (q_1, v_1, q_2, ...) and time; then,
  !! optionally, the time from which peaks and means of all coordinates are requested.
  subroutine new_watch(watch, vector, sides, n_dof)
    type(watch_type), intent(out) :: watch
    real(wp), intent(in) :: vector(:)
    !> For each signal its side, then a power of 2 not above its largest value so far, then the
    !! number of steps with missing crossings; absent at the beginning of a run.
    integer, intent(in), optional :: sides(:)
    !> Number of coordinates. If present, states contain only the coordinates that the signals read.
    integer, intent(in), optional :: n_dof
    real(wp) :: numbers(size(vector))
    integer :: i, k, m, n

    n = 0
    if (size(vector) > 0) n = nint(vector(1))
    numbers = vector
    k = 1
    do i = 1, n
      k = k + 3 + 2*nint(vector(k + 3))
    end do
    watch%extremes%wanted = size(vector) > k
    if (size(vector) > k) watch%extremes%from = vector(k + 1)
    if (present(n_dof) .and. watch%extremes%wanted) then
      watch%reads = [(i, i=1, n_dof)]
    else if (present(n_dof) .and. n > 0) then
      watch%reads = pack([(i, i=1, n_dof)], coordinates_read(vector, n_dof))
      numbers = renumbered(vector, n_dof, watch%reads)
    end if
    allocate (watch%signals(n), watch%direction(n), watch%terminal(n))
    allocate (watch%largest(n), source=0.0_wp)
    allocate (watch%lost(n), source=0)
    if (present(sides)) then
      watch%sides = sides(:n)
      if (n > 0) watch%lost = sides(2*n + 1:3*n)
      do i = 1, n
        if (any(sides(i:n + i:n) /= 0)) watch%largest(i) = scale(1.0_wp, sides(n + i))
      end do
    else
      allocate (watch%sides(n), source=0)
    end if
    k = 1
    do i = 1, n
      watch%direction(i) = nint(numbers(k + 1))
      watch%terminal(i) = nint(numbers(k + 2)) /= 0
      m = nint(numbers(k + 3))
      watch%signals(i)%program%code = nint(numbers(k + 4:k + 2*m + 3:2))
      watch%signals(i)%program%number = numbers(k + 5:k + 2*m + 3:2)
      call watch%signals(i)%program%measure()
      k = k + 3 + 2*m
    end do
    allocate (watch%which(0), watch%times(0), watch%states(0, 0), watch%accelerations(0, 0))
    allocate (watch%changes(2, 0))
  end subroutine new_watch

  !> True for each of n coordinates if the signals read it or its velocity.
  pure function coordinates_read(vector, n) result(read_at_all)
    !> As in `new_watch`.
    real(wp), intent(in) :: vector(:)
    integer, intent(in) :: n
    logical :: read_at_all(n)
    integer :: i, k, m, place

    read_at_all = .false.
    k = 1
    do i = 1, nint(vector(1))
      m = nint(vector(k + 3))
      do place = k + 4, k + 2*m + 3, 2
        if (nint(vector(place)) /= put_argument) cycle
        if (nint(vector(place + 1)) <= 2*n) read_at_all((nint(vector(place + 1)) + 1)/2) = .true.
      end do
      k = k + 3 + 2*m
    end do
  end function coordinates_read

  !> The same signals for states that contain only some of n coordinates.
  pure function renumbered(vector, n, places) result(other)
    real(wp), intent(in) :: vector(:)
    integer, intent(in) :: n
    !> The coordinates in the states.
    integer, intent(in) :: places(:)
    real(wp) :: other(size(vector))
    integer :: i, k, m, place, argument

    other = vector
    k = 1
    do i = 1, nint(vector(1))
      m = nint(vector(k + 3))
      do place = k + 4, k + 2*m + 3, 2
        if (nint(vector(place)) /= put_argument) cycle
        argument = nint(vector(place + 1))
        if (argument > 2*n) then
          other(place + 1) = argument - 2*n + 2*size(places)
        else
          other(place + 1) = 2*findloc(places, (argument + 1)/2, 1) - modulo(argument, 2)
        end if
      end do
      k = k + 3 + 2*m
    end do
  end function renumbered

  !> Number of stored crossings of one signal.
  pure integer function count_of(self, which)
    class(watch_type), intent(in) :: self
    integer, intent(in) :: which
    count_of = count(self%which(:self%n_found) == which)
  end function count_of

  !> Crossings in a step that count, ascending, up to the first one that ends the run.
  subroutine look(self, path, sticks, found)
    class(watch_type), intent(inout) :: self
    type(step_path), intent(in) :: path
    !> True if the motion sticks to a surface of the system, or reaches one at the end of the step:
    !! a signal that is 0 there, but for rounding, has not crossed 0.
    logical, intent(in) :: sticks
    type(event_point_type), allocatable, intent(out) :: found(:)
    type(event_point_type) :: next
    real(wp) :: g(size(path%points))
    integer :: i, k

    allocate (found(0))
    do i = 1, size(self%signals)
      call self%signals(i)%at(path%start + path%h*path%points, path%q, path%v, g)
      if (any(abs(g) < wall)) then
        self%largest(i) = max(self%largest(i), valued, maxval(abs(g), abs(g) < wall))
      end if
      associate (largest => self%largest(i))
        call self%search%find(self%signals(i), path, merge(at_rest*largest, 0.0_wp, sticks), &
                              largest, self%sides(i))
      end associate
      ! Its only values may be between the points.
      if (self%search%n > 0 .or. self%sides(i) /= 0) then
        self%largest(i) = max(self%largest(i), valued)
      end if
      if (self%search%lost) self%lost(i) = self%lost(i) + 1
      do k = 1, self%search%n
        if (self%direction(i)*self%search%to(k) < 0) cycle
        next%which = i
        next%side = -self%search%to(k)
        next%place = self%search%places(k)
        call self%search%change_at(self%signals(i)%program, path, next%place, next%rate, next%bend)
        call insert(found, next)
      end do
    end do
    do i = 1, size(found)
      if (.not. self%terminal(found(i)%which)) cycle
      found = found(:i)
      return
    end do
  end subroutine look

  subroutine insert(found, next)
    type(event_point_type), allocatable, intent(inout) :: found(:)
    type(event_point_type), intent(in) :: next
    integer :: n
    n = count(found%place <= next%place)
    found = [found(:n), next, found(n + 1:)]
  end subroutine insert

  !> Store a crossing.
  subroutine keep(self, event_point, t, q, v, a)
    class(watch_type), intent(inout) :: self
    type(event_point_type), intent(in) :: event_point
    !> Time; coordinates, velocities and accelerations.
    real(wp), intent(in) :: t, q(:), v(:), a(:)
    integer, allocatable :: more_which(:)
    real(wp), allocatable :: more_times(:), more_states(:, :), more(:, :), more_changes(:, :)
    integer :: n

    n = self%n_found
    if (n == size(self%which)) then
      allocate (more_which(2*n + 8), more_times(2*n + 8), more_states(2*size(q), 2*n + 8))
      allocate (more(size(q), 2*n + 8), more_changes(2, 2*n + 8))
      if (n > 0) then
        more_which(:n) = self%which
        more_times(:n) = self%times
        more_states(:, :n) = self%states
        more(:, :n) = self%accelerations
        more_changes(:, :n) = self%changes
      end if
      call move_alloc(more_which, self%which)
      call move_alloc(more_times, self%times)
      call move_alloc(more_states, self%states)
      call move_alloc(more, self%accelerations)
      call move_alloc(more_changes, self%changes)
    end if
    n = n + 1
    self%n_found = n
    self%which(n) = event_point%which
    self%changes(:, n) = [event_point%rate, event_point%bend]
    self%accelerations(:, n) = a
    self%times(n) = t
    self%states(1::2, n) = q
    self%states(2::2, n) = v
  end subroutine keep

  !> Discard crossings after the time at which the motion stopped.
  subroutine drop_after(self, t)
    class(watch_type), intent(inout) :: self
    real(wp), intent(in) :: t
    do while (self%n_found > 0)
      if (self%times(self%n_found) <= t) exit
      self%n_found = self%n_found - 1
    end do
  end subroutine drop_after

  !> Crossings in the form for `event_point_errors`: one column each, of the first n coordinates.
  pure function rows(self, n, n_found)
    class(watch_type), intent(in) :: self
    integer, intent(in) :: n, n_found
    real(wp) :: rows(n_event_rows + 3*n, n_found)
    if (n_found == 0) return
    rows(1, :) = self%which(:n_found)
    rows(2, :) = self%times(:n_found)
    rows(3:2*n + 2, :) = self%states(:2*n, :n_found)
    rows(2*n + 3:3*n + 2, :) = self%accelerations(:n, :n_found)
    rows(3*n + 3:, :) = self%changes(:, :n_found)
  end function rows

  !> Copy the crossings, as many as fit; each column contains the signal, the time, the state and
  !! the accelerations of the first coordinates, and the rate and bend of the signal. Three further
  !! columns contain peaks, integrals and integrals of squares, if they are requested.
  subroutine hand_over(self, sides, found, n_found)
    class(watch_type), intent(in) :: self
    integer, intent(inout) :: sides(:)
    real(wp), intent(inout) :: found(:, :)
    !> Number of crossings, even if fewer fit.
    integer, intent(out) :: n_found
    integer :: n, description
    description = 2*((size(found, 1) - n_event_rows)/3)
    n = size(self%sides)
    sides(:n) = self%sides
    sides(n + 1:2*n) = exponent(max(self%largest, tiny(1.0_wp))) - 1
    sides(2*n + 1:3*n) = self%lost
    n_found = self%n_found
    n = min(n_found, size(found, 2))
    if (allocated(self%extremes%peak) .and. n + 3 <= size(found, 2)) then
      found(3:description + 2, n + 1) = self%extremes%peak(:description)
      found(3:description + 2, n + 2) = self%extremes%total(:description)
      found(3:description + 2, n + 3) = self%extremes%squares(:description)
    end if
    found(:, :n) = self%rows(description/2, n)
  end subroutine hand_over

end module viscovib_watch
