!> Scenes: defaults, canonical text, and error messages with line numbers.
module test_scene
  use test_scene_files, only: remove_scratch, scratch, write_scratch
  use testing, only: begin, check, check_close, check_fails, check_ok
  use viscovib_kernel_table, only: read_kernel_table
  use viscovib_kinds, only: wp
  use viscovib_mount, only: geometry_cubic
  use viscovib_response_job, only: response_job
  use viscovib_response_plan, only: method_auto, method_linear
  use viscovib_scene, only: read_scene, scene_type
  use viscovib_status, only: clipped, status_input_error, status_io_error, status_type
  implicit none
  private

  public :: run_scene

  character(len=*), parameter :: nl = new_line('a')
  !> A scene in four lines.
  character(len=*), parameter :: mount = &
    '&mount mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2 /'//nl
  character(len=*), parameter :: kernel = &
    '&kernel kind=''rzhanitsyn'', amplitude=0.048, alpha=0.1, beta=0.05 /'//nl
  character(len=*), parameter :: system = '&system coordinates=''x'', mass=1, stiffness=1 /'//nl
  character(len=*), parameter :: load = '&load amplitude=0.1 /'//nl
  character(len=*), parameter :: response = '&response nu = 1 2 4 /'//nl

contains

  subroutine run_scene()
    type(scene_type) :: scene
    type(status_type) :: status
    real(wp), allocatable :: times(:), values(:)

    if (begin('what is not given has its default')) then
      call read_text(mount//load//response, scene, status)
      call check_ok(status)
      call check(scene%subject%mount%parameters%geometry == geometry_cubic, 'geometry')
      call check(all(scene%subject%mount%kernel_of == 0), 'no memory')
      associate (job => scene%job)
        select type (job)
        type is (response_job)
          call check(job%method == method_auto, 'method')
          call check(job%options%harmonics == 9, 'harmonics')
          call check_close(job%options%tolerance, 1.0e-10_wp, 0.0_wp, 'tolerance')
        class default
          call check(.false., 'a response')
        end select
      end associate
      call check(scene%title == '', 'title')
      call check(all(scene%subject%load%orders == [1]), 'order of the load')
    end if

    if (begin('loads add up, phases and all')) then
      call read_text(mount//load//'&load amplitude=2, phase=1 /'//nl &
                     //'&load order=0, on=''phi'', '// &
                     'amplitude=3 /'//nl//'&load kind=''base'', order=2, amplitude=0.5 /'//nl &
                     //'&response nu=1, method=''linear'' /', scene, status)
      call check_ok(status)
      associate (job => scene%job)
        select type (job)
        type is (response_job)
          call check(job%method == method_linear, 'method')
        class default
          call check(.false., 'a response')
        end select
      end associate
      associate (load => scene%subject%load)
        call check(all(load%orders == [0, 1, 2]), 'orders')
        call check_close(aimag(load%force(2, 1)), 3.0_wp, 0.0_wp, 'mean')
        call check_close(real(load%force(1, 2)), 0.1_wp + 2.0_wp*cos(1.0_wp), 1.0e-15_wp, &
                         'cosine')
        call check_close(aimag(load%force(1, 2)), 2.0_wp*sin(1.0_wp), 1.0e-15_wp, 'sine')
        call check_close(real(load%base(3)), 0.5_wp, 0.0_wp, 'base')
      end associate
    end if

    if (begin('the canonical text reads back to itself')) then
      call round_trip(mount//load//response)
      call round_trip('&scene title=''it''''s a "title" / &'' /'//nl//mount//kernel//load &
                      //'&load order=0, amplitude=-1e-300 /'//nl//'&load kind=''base'', order=3, ' &
                      //'amplitude=0.1, phase=-0.7/'//nl//'&response nu_from=0.3, nu_to=12, ' &
                      //'nu_count=5, nu_spacing=''log'', relaxation=0.3 /')
      call round_trip(mount//'&kernel acts_on=''phi'', kind=''prony'', weights=5*0.01, ' &
                      //'rates=1 2 3 4 5 /'//nl//'&kernel acts_on=''x'', kind=''tabulated'', ' &
                      //'times=0 1, values=0.1 0.05, interpolation=''exponential'' /'//nl &
                      //load//response)
    end if

    if (begin('a tabulated kernel may stand in a file')) then
      call write_scratch('kernel.txt', '# time, value'//nl//'0 0.1'//nl//nl//' 1.0,5d-2 ! half' &
                         //achar(13)//nl//'2'//achar(9)//'.01')
      call read_text(mount//"&kernel kind='tabulated', file='"//scratch('kernel.txt')//"' /"//nl &
                     //load//response, scene, status)
      call check_ok(status)
      call check(index(scene%canonical, 'file') == 0, 'what the file holds is written out')
      call check(index(scene%canonical, '5.0000000000000003e-02') > 0, 'the second value')
      call read_kernel_table(scratch('kernel.txt'), times, values, status)
      call check_ok(status)
      call check(size(times) == 3 .and. size(values) == 3, 'three pairs')
      call check_close(times(3) + values(3), 2.01_wp, 0.0_wp, 'the last, without a line end')
    end if

    if (begin('what is wrong with such a file, and where')) then
      call wrong_table('0 1'//nl//'1'//nl, scratch('kernel.txt')//":2: a line must be two finite")
      call wrong_table('0 1'//nl//nl//'1 2 3'//nl, scratch('kernel.txt') &
                       //":3: a line must be two")
      call wrong_table('t R'//nl//'1 2'//nl, scratch('kernel.txt')//":1: a line must be two finite")
      call wrong_table('0 1'//nl//achar(0), scratch('kernel.txt')//':2: byte 0 found')
      call wrong_table('0 1'//nl//'0 0.5', ':2: file: times (value 2) = 0 after 0')
      call wrong_table('# nothing', ':2: file: times and values have 0 and 0 numbers')
      call remove_scratch('kernel.txt')
      call read_text(mount//"&kernel kind='tabulated', file='"//scratch('kernel.txt')//"' /"//nl &
                     //load//response, scene, status)
      call check_fails(status, ':2: file: '//scratch('kernel.txt')//': cannot be read (No such')
      call check(status%category == status_io_error, 'an i/o error')
    end if

    if (begin('lists that belong together are of one length')) then
      call wrong(mount//"&kernel kind='prony', weights=1 2 3,"//nl//'rates=4 /'//nl//load &
                 //response, &
                 ':3: weights and rates have 3 and 1 numbers: must match')
      call wrong(mount//"&kernel kind='tabulated', times=0 1 2,"//nl//'values=1 /'//nl//load &
                 //response, ':3: times and values have 3 and 1 numbers: must match')
    end if

    if (begin('a system of one''s own')) then
      call read_text(kernel//"&system coordinates='Body' 'rod', mass=1 0.1, stiffness=3 -1 -2 2 /" &
                     //nl//'&spring stiffness=1 0, kernel=0 /'//nl &
                     //"&force on='BODY', coefficient=0.5, powers=2 1 /"//nl &
                     //"&load on='rod', amplitude=0.1 /"//nl//response, scene, status)
      call check_ok(status)
      call check(all(scene%subject%coordinates == ['body', 'rod ']), 'names')
      call check(all(scene%subject%units == 'm'), 'units')
      call check_close(scene%subject%polynomial%gather(1, 1), 1.0_wp, 0.0_wp, 'no memory')
      call check_close(scene%subject%polynomial%gather(2, 2), -1.0_wp, 0.0_wp, 'rows first')
      call check(all(scene%subject%polynomial%kernel_of == [0, 1, 1]), 'the first kernel')
      call check_close(real(scene%subject%load%force(2, 1)), 0.1_wp, 0.0_wp, 'on the second')
      call round_trip(kernel//"&system coordinates='a' 'b' 'c', units='m' 'rad' 'it''s', " &
                      //'mass=1 2 3, damping=9*0.1, base_direction=1 0 1, kernel=0 /'//nl &
                      //"&force on='c', coefficient=-1e-3, powers=0 0 3, kernel=1 /"//nl &
                      //"&load kind='base', amplitude=1 /"//nl//response)
    end if

    if (begin('forces written as laws')) then
      call read_text("&system coordinates='a' 'b', mass=1 1, stiffness=1 1 /"//nl &
                     //"&force on='b', law='-(A - 2*b)^2*.5 + 1e-1*a**3/4 - b*(a-a)^0' /"//nl &
                     //load//response, scene, status)
      call check_fails(status, ':2: law: powers must not')
      call read_text("&system coordinates='a' 'b', mass=1 1, stiffness=1 1 /"//nl &
                     //"&force on='b', law='-(A - 2*b)^2*.5 + 1e-1*a**3/4 - b*(a-a)' /"//nl &
                     //load//response, scene, status)
      call check_ok(status)
      associate (m => scene%subject%polynomial%monomials)
        call check(size(m) == 4 .and. all(m%equation == 2), 'a^2, a b, b^2 and a^3')
        call check(all(abs(m%coefficient - [-0.5_wp, 2.0_wp, -2.0_wp, 0.025_wp]) < 1.0e-16_wp), &
                   'coefficients')
      end associate
      call round_trip(kernel//"&system coordinates='a' 'b', mass=1 1, stiffness=1 1 /"//nl &
                      //"&force on='b', law='(a - b)^3', kernel=0 /"//nl &
                      //"&force on='a', law='a - a' /"//nl//load//response)
    end if

    if (begin('what is wrong with such a system, and where')) then
      call wrong(system//load//response//'&force coefficient=1,'//nl//'powers=1 /', &
                 ':5: powers: powers must not be negative, and their sum 2 to 15')
      call wrong(system//load//response//'&force coefficient=1,'//nl//'powers=1 2 /', &
                 ':5: powers has 2 values: must be 1')
      call wrong(system//load//response//'&force coefficient=1,'//nl//'powers=1.5 /', &
                 ':5: powers = 1.5: must be integers')
      call wrong(system//load//response//'&force coefficient=1, powers=2,'//nl//'kernel=1 /', &
                 ':5: kernel = 1: must be 0 (none) to 0')
      call wrong(system//load//response//"&force coefficient=1, powers=2,"//nl//"on='y' /", &
                 ":5: on = 'y': must be one of 'x'")
      call wrong_law("x^2 +", "at its end: expected a number, a coordinate or (")
      call wrong_law("(x^2", "at its end: expected )")
      call wrong_law("x^2)", "')' (character 4): expected + - * / ^ or the end")
      call wrong_law("2 x^2", "'x' (character 3): expected + - * / ^ or the end")
      call wrong_law("y^2", "'y' is not a coordinate")
      call wrong_law("x^1.5", "must be defined near rest")
      call wrong_law("x^-2", "must be defined near rest")
      call wrong_law("1/x", "must be defined near rest")
      call wrong_law("x^2/0", "it may be divided only by numbers other than 0")
      call wrong_law("1e999*x^2", "'1e999' is not a finite number")
      call wrong_law("x^2/1e-200", "must be defined near rest")
      call wrong_law(repeat('(', 200)//'x', "it must not be nested deeper than 100")
      call wrong_law("x + x^3", "what is linear belongs to the stiffness", "law: powers must")
      call wrong_law("2*", "at its end: expected a number, a coordinate or (")
      call wrong(system//load//response//"&force law='x^2', coefficient=1 /", &
                 ':4: coefficient: the law says it already')
      call wrong(system//load//response//'&spring stiffness=1 2 3 /', &
                 ':4: stiffness has 3 values: must be 1')
      call wrong("&system coordinates='x',"//nl//'mass=0 /'//nl//load//response, &
                 ':2: mass: must be symmetric and positive definite')
      call wrong("&system coordinates='x' 'X', mass=1 1 /"//nl//load//response, &
                 ":1: coordinates: 'x' is there twice")
      call wrong("&system coordinates='x^2', mass=1 /"//nl//load//response, &
                 ":1: coordinates: 'x^2' must be letters")
      call wrong("&system coordinates=1, mass=1 /"//nl//load//response, &
                 ':1: coordinates = 1: must be quoted texts')
      call wrong("&system coordinates='abcdefghijklmnopq', mass=1 /"//nl//load//response, &
                 ":1: coordinates = 'abcdefghijklmnopq': must have 1 to 16 characters")
      call wrong("&system coordinates='x', units='m' 'm', mass=1 /"//nl//load//response, &
                 ':1: units: 2 texts, must be 1')
      call wrong(system//mount//load//response, ':2: &mount: this scene has &system already')
      call wrong(mount//load//response//'&spring stiffness=1 /', ':4: &spring: needs &system')
      call wrong(system//"&kernel acts_on='x', kind='abel', amplitude=0.1, alpha=1 /"//nl//load &
                 //response, ':2: acts_on: belongs to a mount')
      call wrong(system//"&load kind='base', amplitude=1 /"//nl//response, &
                 ":2: kind = 'base': needs base_direction")
      call wrong(system//'&transient initial=0 0, t_end=1, nu=1 /', ':2: nu: is the frequency of')
      call wrong(system//load//'&transient initial=0 0, t_end=1 /', ':3: &transient lacks nu')
      call wrong(system//load//'&transient initial=0 0, t_end=1,'//nl//'nu=0 /', ':4: nu = 0: must')
      call wrong(system//load//'&transient initial=0 0 0, t_end=1, nu=1 /', &
                 ':3: initial has 3 values: must be 2')
      call wrong(system//load//response//'&transient initial=0 0, t_end=1, nu=1 /', &
                 ':3: &response: this scene has &transient already')
      call wrong(mount//load//'&transient t_end=1 /', ':3: &transient lacks nu')
      call wrong(load//'&transient t_end=1 /', &
                 ':2: &transient: needs &mount, &system, &structure, &body or')
      call wrong(system//load//response//'&spectrum /', ':4: &spectrum: needs &transient')
      call wrong(system//load//"&transient initial=0 0, t_end=1, nu=1, memory='auto' /", &
                 ':3: unknown key ''memory''')
      call wrong(system//load//"&response nu=1, method='newton',"//nl//'harmonics=0 /', &
                 ':4: harmonics = 0')
    end if

    if (begin('groups too many, too few, unknown')) then
      call wrong(mount//load, ': no &response group: a scene needs')
      call wrong(mount//response, ': no &load group')
      call wrong(load//response, ': no &mount group')
      call wrong(mount//load//response//mount, ':4: a second &mount')
      call wrong(mount//load//response//'&pendulums /', &
                 ':4: unknown group &pendulums; did you mean &pendulum?')
      call wrong(mount//load//response//'&zebra /', ':4: unknown group &zebra: must be one of &')
      call wrong(mount//kernel//kernel//load//response, ":3: acts_on = 'both': this spring has")
      call wrong(mount//"&kernel acts_on='x', kind='abel', amplitude=0.1, alpha=1 /"//nl//kernel &
                 //load//response, ":3: acts_on = 'both': this spring has")
    end if

    if (begin('keys that have no meaning here')) then
      call wrong(mount//load//'&response nu=1 2,'//nl//'nu_count=3 /', &
                 ':4: nu_count: the frequencies')
      call wrong(mount//"&load kind='base', on='phi', amplitude=1 /"//nl//response, ':2: on: ')
      call wrong(mount//'&load order=0, amplitude=1, phase=0 /'//nl//response, &
                 ':2: phase: the mean')
      call wrong(mount//"&kernel kind='abel', amplitude=1, alpha=1, beta=1 /"//nl//load//response, &
                 ":2: unknown key 'beta' in &kernel: must be one of acts_on, kind, amplitude")
    end if

    if (begin('values out of range have their line')) then
      call wrong(mount//kernel//load//'&response nu=1,'//nl//'tolerance=-1 /', ':5: tolerance = -1')
      call wrong(mount//kernel//load//'&response nu=1,'//nl//'harmonics=400 /', &
                 ':5: harmonics = 400')
      call wrong(mount//kernel//load//'&response nu=1,'//nl//'relaxation=2 /', ':5: relaxation = 2')
      call wrong(mount//load//'&response nu=1,'//nl//'max_iterations=0 /', ':4: max_iterations = 0')
      call wrong(mount//'&load order=11, amplitude=1 /'//nl//'&response nu=1,'//nl// &
                 'harmonics=9 /', ':4: harmonics = 9: must be at least 11')
      call wrong(mount//'&load order=-1, amplitude=1 /'//nl//response, ':2: order = -1: must be 0')
      call wrong(mount//'&load order=2000000000, amplitude=1 /'//nl//response, &
                 ':2: order = 2000000')
      call wrong(mount//load//'&response nu=0 1 /', ':3: nu = 0: must be greater than 0')
      call wrong(mount//load//'&response nu=1 1 /', ':3: nu (value 2) = 1 after 1')
      call wrong(mount//load//'&response nu_from=1, nu_to=2, nu_count=1000001 /', &
                 ':3: nu_count = 1000001: must be 2 to 1000000')
      call wrong(mount//load//'&response nu_from=2, nu_to=1, nu_count=3 /', ':3: nu_to = 1')
      call wrong('&mount mass=0, inertia=0.1, offset=0.5,'//nl//'stiffness_x=10, stiffness_phi=2/' &
                 //nl//load//response, ':1: mass = 0: must be greater than 0')
    end if

    if (begin('a mean needs every kernel''s integral: the line of that kernel')) then
      call wrong(mount//"&kernel acts_on='x', kind='abel', amplitude=0.1, alpha=0.5 /"//nl &
                 //'&load order=0, amplitude=1 /'//nl//response, ':2: a kernel has no finite')
      call wrong(mount &
                 //"&kernel acts_on='x', kind='rzhanitsyn', amplitude=0.1, alpha=0.5, beta=1 /" &
                 //nl//"&kernel acts_on='phi', kind='rzhanitsyn', amplitude=0.1, alpha=0.5,"//nl &
                 //' beta=0 /'//nl//'&load order=0, amplitude=1 /'//nl//response, &
                 ':4: a kernel has no finite')
    end if
    call remove_scratch('scene.nml')
  end subroutine run_scene

  subroutine read_text(text, scene, status)
    character(len=*), intent(in) :: text
    type(scene_type), intent(out) :: scene
    type(status_type), intent(out) :: status
    call write_scratch('scene.nml', text)
    call read_scene(scratch('scene.nml'), scene, status)
  end subroutine read_text

  subroutine round_trip(text)
    character(len=*), intent(in) :: text
    type(scene_type) :: first, second
    type(status_type) :: status
    call read_text(text, first, status)
    call check_ok(status)
    if (status%failed()) return
    call read_text(first%canonical, second, status)
    call check_ok(status)
    if (status%failed()) return
    call check(second%canonical == first%canonical, 'same text: '//second%canonical)
    call check(all(abs(frequencies(second) - frequencies(first)) <= 0.0_wp), 'same frequencies')
    call check(second%title == first%title, 'same title')
  end subroutine round_trip

  subroutine wrong(text, message)
    character(len=*), intent(in) :: text, message
    type(scene_type) :: scene
    type(status_type) :: status
    call read_text(text, scene, status)
    call check_fails(status, scratch('scene.nml')//message)
    call check(status%category == status_input_error, 'an input error')
  end subroutine wrong

  !> A scene whose kernel is in a file with this text.
  subroutine wrong_table(text, message)
    character(len=*), intent(in) :: text, message
    type(scene_type) :: scene
    type(status_type) :: status
    call write_scratch('kernel.txt', text)
    call read_text(mount//"&kernel kind='tabulated', file='"//scratch('kernel.txt')//"' /"//nl &
                   //load//response, scene, status)
    call check_fails(status, message)
    call check(status%category == status_input_error, 'an input error')
  end subroutine wrong_table

  !> A law in the fourth line, and the expected message.
  subroutine wrong_law(law, message, start)
    character(len=*), intent(in) :: law, message
    character(len=*), intent(in), optional :: start
    type(scene_type) :: scene
    type(status_type) :: status
    call read_text(system//load//response//"&force law='"//law//"' /"//nl, scene, status)
    call check_fails(status, message)
    if (present(start)) then
      call check_fails(status, ':4: '//start)
    else
      call check_fails(status, ":4: law = '"//clipped(law)//"': ")
    end if
  end subroutine wrong_law

  !> Frequencies of a scene with a response.
  function frequencies(scene) result(nu)
    type(scene_type), intent(in) :: scene
    real(wp), allocatable :: nu(:)
    associate (job => scene%job)
      select type (job)
      type is (response_job)
        nu = job%nu
      end select
    end associate
  end function frequencies

end module test_scene
