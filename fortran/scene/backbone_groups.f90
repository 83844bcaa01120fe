!> The &backbone group of a scene.
module viscovib_backbone_groups
  use viscovib_backbone_job, only: backbone_job
  use viscovib_backbone_plan, only: backbone_plan_type, new_backbone_plan
  use viscovib_curve_groups, only: check_between, read_curve, read_switch
  use viscovib_free_family, only: free_options
  use viscovib_free_orders, only: most_chosen
  use viscovib_free_pendulum, only: begin_free, pendulum_names
  use viscovib_free_structure, only: free_structure, structure_modes
  use viscovib_group_reader, only: group_reader
  use viscovib_kinds, only: wp
  use viscovib_limits, only: max_harmonics
  use viscovib_oscillator, only: oscillator_type
  use viscovib_pendulum, only: pendulum_type
  use viscovib_status, only: show, status_type
  use viscovib_structure, only: structure_type
  use viscovib_structure_model, only: structure_model
  implicit none
  private

  public :: read_backbone, read_free, read_structure_backbone

  !> Sizes that count as equal, relative.
  real(wp), parameter :: equal = 1.0e-9_wp

contains

  !> Of a mount or a polynomial system.
  subroutine read_backbone(reader, system, coordinates, job)
    type(group_reader), intent(inout) :: reader
    class(oscillator_type), intent(in) :: system
    character(len=*), intent(in) :: coordinates(:)
    type(backbone_job), intent(out) :: job
    type(backbone_plan_type) :: plan
    type(status_type) :: status
    character(len=:), allocatable :: word, name

    call read_common(reader, coordinates, job, name)
    if (reader%status%failed()) return
    call new_backbone_plan(plan, system, job%mode, job%dof, name, job%harmonics, &
                           job%choose_harmonics, job%options%tolerance, status)
    call reader%place(status)
    if (status%failed() .or. job%dof > 0) return
    word = reader%read_text('dof', trim(coordinates(plan%dof)), coordinates, job%dof)
  end subroutine read_backbone

  !> Of a structure, by the amplitude of any of its coordinates.
  subroutine read_structure_backbone(reader, model, coordinates, job)
    type(group_reader), intent(inout) :: reader
    type(structure_model), intent(in) :: model
    character(len=*), intent(in) :: coordinates(:)
    type(backbone_job), intent(out) :: job
    type(structure_model) :: free
    type(structure_type) :: system
    type(backbone_plan_type) :: plan
    type(status_type) :: status
    character(len=:), allocatable :: word, name
    integer :: place

    call read_common(reader, coordinates, job, name)
    call check_between(reader, 'mode', job%mode, 0, model%rest%n_modes() - 1)
    if (reader%status%failed()) return
    place = job%dof
    if (place == 0) call find_moving_most(model, job%mode, place, status)
    if (place > 0) call free_structure(model, place, free, system, status)
    if (.not. status%failed()) then
      call new_backbone_plan(plan, system, job%mode, 1, name, job%harmonics, &
                             job%choose_harmonics, job%options%tolerance, status)
    end if
    call reader%place(status)
    if (status%failed() .or. job%dof > 0) return
    word = reader%read_text('dof', trim(coordinates(place)), coordinates, job%dof)
  end subroutine read_structure_backbone

  !> The coordinate that moves most in a mode, weighed by the root of its inertia where that is its
  !! own.
  subroutine find_moving_most(model, mode, place, status)
    type(structure_model), intent(in) :: model
    !> Counted from 0.
    integer, intent(in) :: mode
    integer, intent(out) :: place
    type(status_type), intent(out) :: status
    real(wp) :: omega(model%rest%n_modes()), shapes(size(model%places, 1), model%rest%n_modes())
    integer :: d

    place = 0
    call structure_modes(model, omega, shapes, status)
    if (status%failed()) return
    associate (moved => shapes(:, mode + 1))
      moved = abs(moved)
      if (.not. model%is_reduced) then
        moved = moved*sqrt([(model%mass(d, d), d=1, size(moved))])
      end if
      place = findloc(moved >= (1.0_wp - equal)*maxval(moved), .true., 1)
    end associate
  end subroutine find_moving_most

  !> What all but a pendulum have.
  subroutine read_common(reader, coordinates, job, name)
    type(group_reader), intent(inout) :: reader
    character(len=*), intent(in) :: coordinates(:)
    type(backbone_job), intent(inout) :: job
    !> Of the coordinate whose amplitude counts; '' if none is named.
    character(len=:), allocatable, intent(out) :: name
    character(len=:), allocatable :: word

    allocate (job%switch(0))
    job%mode = reader%read_integer('mode')
    call read_ends(reader, job)
    call reader%read_count('harmonics', job%harmonics, job%choose_harmonics)
    call read_curve(reader, job%options)
    name = ''
    if (reader%has('dof')) then
      word = reader%read_text('dof', allowed=coordinates, choice=job%dof)
      if (job%dof > 0) name = trim(coordinates(job%dof))
    end if
  end subroutine read_common

  !> Of a pendulum.
  subroutine read_free(reader, pendulum, job)
    type(group_reader), intent(inout) :: reader
    type(pendulum_type), intent(in) :: pendulum
    type(backbone_job), intent(out) :: job
    character(len=:), allocatable :: word
    type(free_options) :: free
    type(pendulum_type) :: system
    type(status_type) :: status

    free%mode = reader%read_integer('mode')
    word = reader%read_text('parameter', choice=job%parameter)
    call read_ends(reader, job)
    free%order = reader%read_integer('subharmonic')
    call reader%read_count('harmonics', free%highest, free%chosen)
    call read_curve(reader, job%options)
    free%stability = reader%read_yes('stability')
    free%symmetric = reader%read_text('symmetry') == 'kept'
    call read_switch(reader, job%switch)
    if (reader%status%failed()) return
    call check_between(reader, 'mode', free%mode, 0, 2)
    if (reader%status%failed()) return
    if (free%chosen) free%highest = min(free%highest, most_chosen(free%order))
    free%most = merge(most_chosen(free%order), free%highest, free%chosen)
    call check_between(reader, 'harmonics', free%highest, 1, max_harmonics/free%order)
    if (job%parameter > 1) then
      call reader%refuse(['dof'], "is allowed with parameter = 'amplitude' only")
    else if (reader%has('dof')) then
      word = reader%read_text('dof', allowed=pendulum_names, choice=free%dof)
    end if
    if (reader%status%failed()) return
    free%curve = job%options
    call begin_free(pendulum, job%parameter > 1, free, system, status)
    call reader%place(status)
    if (.not. (status%failed() .or. job%parameter > 1 .or. reader%has('dof'))) then
      word = reader%read_text('dof', trim(pendulum_names(free%dof)), pendulum_names, free%dof)
    end if
    job%free = free
  end subroutine read_free

  !> Sizes from which and to which.
  subroutine read_ends(reader, job)
    type(group_reader), intent(inout) :: reader
    type(backbone_job), intent(inout) :: job

    job%options%start = reader%read_real('from')
    job%options%finish = reader%read_real('to')
    if (reader%status%failed()) return
    if (.not. job%options%finish > job%options%start) then
      call reader%complain('to', 'to = '//show(job%options%finish)//': must be greater than from')
    end if
  end subroutine read_ends

end module viscovib_backbone_groups
