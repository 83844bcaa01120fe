!> The &ensemble group of a scene.
module viscovib_ensemble_groups
  use viscovib_explicit_tables, only: lane_methods
  use viscovib_grids, only: linear_grid
  use viscovib_group_reader, only: group_reader
  use viscovib_growing_text, only: growing_text
  use viscovib_motion_choice, only: hereditary_methods
  use viscovib_kinds, only: wp
  use viscovib_law_parameters, only: read_parameters
  use viscovib_load_groups, only: read_frequency
  use viscovib_many_job, only: many_job
  use viscovib_many_runs, only: of_load, of_parameter, system_numbers
  use viscovib_method_catalogue, only: transient_methods
  use viscovib_motion_groups, only: read_forces
  use viscovib_namelist, only: namelist_type
  use viscovib_near_words, only: listed, longest
  use viscovib_number_text, only: exact
  use viscovib_repeating_groups, only: read_accuracy
  use viscovib_scene_groups, only: place_of
  use viscovib_scene_subject, only: read_subject
  use viscovib_shooting, only: accuracy_type
  use viscovib_status, only: show, status_type
  use viscovib_subject, only: subject_type
  use viscovib_varied_system, only: varied_system
  implicit none
  private

  public :: read_ensemble

  !> Default of the tolerance.
  real(wp), parameter :: usual_error = 1.0e-8_wp

  !> The system of a scene with other values of one of its &parameters.
  type, extends(varied_system) :: varied_parameter
    type(namelist_type) :: file
    character(len=:), allocatable :: name
  contains
    procedure :: make
  end type varied_parameter

contains

  subroutine read_ensemble(reader, file, subject, job)
    type(group_reader), intent(inout) :: reader
    type(namelist_type), intent(in) :: file
    type(subject_type), intent(in) :: subject
    type(many_job), intent(out) :: job
    type(accuracy_type) :: accuracy
    real(wp) :: from, to
    integer :: count_of

    job%lyapunov = reader%read_yes('lyapunov')
    job%side_by_side = subject%goes_side_by_side(job%lyapunov)
    call check_subject(reader, subject)
    if (reader%status%failed()) return
    if (subject%is_pendulum) then
      job%vary = reader%read_text('vary', choice=job%place)
    else
      call read_varied(reader, file, job)
    end if
    from = reader%read_real('from')
    to = reader%read_real('to')
    count_of = reader%read_integer('count')
    if (reader%status%failed()) return
    job%values = linear_grid(from, to, count_of)
    if (.not. subject%is_pendulum) call read_system(reader, subject, from, to, job)
    if (reader%status%failed()) return
    job%initial = reader%read_reals('initial', 2*size(subject%coordinates))
    if (subject%is_structure .and. .not. reader%status%failed()) then
      if (subject%model%is_reduced .and. any(abs(job%initial) > 0.0_wp)) then
        call reader%complain('initial', 'initial: must be 0 of a structure with shapes, whose ' &
                             //'coordinates do not tell its state')
      end if
    end if
    call read_length(reader, subject, job)
    if (reader%status%failed()) return
    job%dt = reader%read_real('dt')
    call read_accuracy(reader, accuracy)
    job%absolute = accuracy%absolute
    job%relative = accuracy%relative
    if (.not. max(job%absolute, job%relative) > 0.0_wp) job%absolute = usual_error
    if (reader%may_have('amplitudes_at')) job%lines = reader%read_reals('amplitudes_at')
    job%sample_every = reader%read_integer('sample_every')
    call read_method(reader, subject, job)
    job%wants_peaks = reader%read_yes('peaks')
    job%wants_accelerations = reader%read_yes('acceleration')
    call read_forces(reader, subject, job%wants_forces)
    if (reader%status%failed()) return
    if (job%wants_peaks .and. .not. subject%is_pendulum .and. job%place > of_load &
        .and. job%place < of_parameter) then
      call reader%complain('peaks', "peaks = 'yes': must be 'no' if a scale of the system varies")
    end if
    if (job%sections == 0 .and. job%dt > job%t_end) then
      call reader%complain('dt', 'dt = '//show(job%dt)//': must not exceed t_end = ' &
                           //show(job%t_end))
    end if
  end subroutine read_ensemble

  !> What has no ensemble.
  subroutine check_subject(reader, subject)
    type(group_reader), intent(inout) :: reader
    type(subject_type), intent(in) :: subject

    if (subject%is_pendulum) return
    if (subject%is_structure) then
      if (abs(subject%model%modal%loss) > 0.0_wp) then
        call reader%complain('ensemble', '&ensemble: loss_factor has no meaning in time, must be ' &
                             //'0 (use a kernel, or modal_damping)')
      end if
    end if
  end subroutine check_subject

  !> The method: of lanes, or of a motion in time.
  subroutine read_method(reader, subject, job)
    type(group_reader), intent(inout) :: reader
    type(subject_type), intent(in) :: subject
    type(many_job), intent(inout) :: job
    character(len=:), allocatable :: method
    character(len=len(transient_methods)), allocatable :: known(:)

    method = reader%read_text('method')
    if (reader%status%failed()) return
    if (job%side_by_side) then
      known = lane_methods
    else if (subject%remembers()) then
      known = hereditary_methods
    else
      known = transient_methods
    end if
    if (method == 'auto') then
      ! The first of those of a motion in time.
      if (.not. job%side_by_side) job%method = 1
      return
    end if
    job%method = findloc(known == method, .true., 1)
    if (job%method > 0) return
    call reader%complain('method', "method = '"//method//"': is not for motions that are " &
                         //'computed '//trim(merge('side by side     ', 'one after another', &
                                      job%side_by_side))//', must be one of ' &
                         //listed(known, "'"))
  end subroutine read_method

  !> What varies of a system: one of its numbers, or a parameter of its laws.
  subroutine read_varied(reader, file, job)
    type(group_reader), intent(inout) :: reader
    type(namelist_type), intent(in) :: file
    type(many_job), intent(inout) :: job
    character(len=longest), allocatable :: names(:)
    type(varied_parameter) :: varied
    integer :: at, i, k, n, n_own

    n = 0
    at = place_of(file, 'parameters')
    if (at <= size(file%groups)) n = file%groups(at)%n_entries
    n_own = merge(size(system_numbers), 2, job%side_by_side)
    allocate (names(n_own + n))
    names(:n_own) = system_numbers(:n_own)
    do i = 1, n
      names(n_own + i) = file%groups(at)%entries(i)%key
    end do
    job%vary = reader%read_text('vary', allowed=names, choice=job%place)
    if (reader%status%failed()) return
    if (count(names == job%vary) > 1) then
      call reader%complain('vary', "vary = '"//job%vary//"': is also one of the &parameters, " &
                           //'which must have another name')
    end if
    if (job%place <= n_own) return
    job%place = of_parameter
    varied%file = file
    varied%name = job%vary
    ! Laws as they were written, with names for numbers.
    do i = 1, size(file%groups)
      do k = 1, file%groups(i)%n_entries
        associate (entry => varied%file%groups(i)%entries(k))
          if (entry%n_values /= 1) cycle
          if (allocated(entry%values(1)%written)) then
            entry%values(1)%text = entry%values(1)%written
            deallocate (entry%values(1)%written)
          end if
        end associate
      end do
    end do
    allocate (job%varied, source=varied)
  end subroutine read_varied

  !> The frequency of the load, and what of a system varies.
  subroutine read_system(reader, subject, from, to, job)
    type(group_reader), intent(inout) :: reader
    type(subject_type), intent(in) :: subject
    real(wp), intent(in) :: from, to
    type(many_job), intent(inout) :: job

    if (job%vary == 'nu') then
      call reader%refuse(['nu'], 'the frequency is what varies')
      if (min(from, to) <= 0.0_wp) then
        call reader%complain('from', 'from, to = '//show(from)//', '//show(to)//': nu must be ' &
                             //'greater than 0')
      end if
    else
      call read_frequency(reader, subject%load, job%nu)
    end if
    if (.not. job%side_by_side) return
    if (job%place > 2 .and. job%place < of_parameter .and. size(subject%polynomial%laws) > 0) then
      call reader%complain('vary', "vary = '"//job%vary//"': must not scale a system with laws " &
                           //'of functions; must be nu or load_scale')
    end if
  end subroutine read_system

  !> Time or periods, and what is left out.
  subroutine read_length(reader, subject, job)
    type(group_reader), intent(inout) :: reader
    type(subject_type), intent(in) :: subject
    type(many_job), intent(inout) :: job
    real(wp) :: span
    integer :: most

    job%sections = reader%read_integer('sections')
    if (reader%status%failed()) return
    most = merge(3, 1, subject%is_pendulum)
    if (job%sections < 0 .or. job%sections > most) then
      call reader%complain('sections', 'sections = '//show(job%sections)//': must be 0 to ' &
                           //show(most))
      return
    end if
    if (job%sections > 0) then
      job%n_periods = reader%read_integer('n_periods')
      if (reader%status%failed()) return
      call reader%refuse(['t_end'], 'the length is n_periods, where sections are wanted')
      span = job%n_periods
    else
      job%t_end = reader%read_real('t_end')
      if (reader%status%failed()) return
      call reader%refuse(['n_periods'], 'is for sections; must be t_end')
      span = job%t_end
    end if
    job%discard = reader%read_real('discard')
    if (reader%status%failed()) return
    if (job%sections > 0 .and. job%discard >= 0.0_wp) then
      job%discard = ceiling(min(job%discard, 1.0e9_wp))
    end if
    if (job%discard < 0.0_wp .or. job%discard >= span) then
      call reader%complain('discard', 'discard = '//show(job%discard)//': must not be negative ' &
                           //'and less than the run, '//show(span))
    end if
  end subroutine read_length

  !> What a scene with this value says, read as that is.
  subroutine make(self, value, subject, status)
    class(varied_parameter), intent(in) :: self
    real(wp), intent(in) :: value
    type(subject_type), intent(out) :: subject
    type(status_type), intent(out) :: status
    type(namelist_type) :: file
    type(growing_text) :: echo
    character(len=:), allocatable :: unused
    integer :: at, i

    file = self%file
    at = place_of(file, 'parameters')
    i = file%groups(at)%find(self%name)
    file%groups(at)%entries(i)%values(1)%text = trim(exact(value))
    call read_parameters(file, unused, echo, status)
    if (.not. status%failed()) call read_subject(file, subject, echo, status)
  end subroutine make

end module viscovib_ensemble_groups
